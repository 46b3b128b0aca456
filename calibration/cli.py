"""Commands of calibration, as one group: heliostats; camera; response of camera and display."""

from importlib import import_module

from heliogauge.running.commands import make_app

app = make_app("Calibration: heliostats; camera; response of camera and display.")
for _instrument in ("screen", "camera", "heliostat"):
    for _name, _command in import_module(f"calibration.{_instrument}.cli").COMMANDS.items():
        app.command(_name)(_command)
