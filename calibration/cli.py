"""Commands of calibration, as one group: heliostats; camera; response of camera and display."""

from calibration.camera.cli import camera_command
from calibration.heliostat.cli import heliostat_command, heliostat_export_command, heliostat_plan_command
from calibration.screen.cli import response_command
from heliogauge.running.commands import make_app

app = make_app("Calibration: heliostats; camera; response of camera and display.")
app.command("response")(response_command)
app.command("camera")(camera_command)
app.command("heliostat")(heliostat_command)
app.command("heliostat-export")(heliostat_export_command)
app.command("heliostat-plan")(heliostat_plan_command)
