"""A scene in three dimensions that a reader of a report can turn, within the page and without anything from elsewhere.

Points and lines are drawn on a canvas by 6 kB of script; a plotting library would add 4 MB to every report.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from heliogauge.errors import InputError
from heliogauge.reporting.html import Html
from heliogauge.validate import FloatArray, float_array

#: Coordinates are written to this share of the scene's size: a thousandth of a pixel.
_DIGITS_SHARE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class SceneGroup:
    """Points or lines of one kind, which the reader can switch off.

    name: What they are; the legend shows it.
    xyz_m (n, 3): Points; for lines the vertices of one line after the other [m].
    colors: One colour for all, or one for each point, as ``#rrggbb``.
    lengths: Number of vertices of each line; none for points.
    labels: What is shown when the pointer is at a point.
    size_px: Diameter of the points, width of the lines.
    shown: Whether it is switched on at first.
    InputError: Numbers of points, colours, labels and vertices do not fit.
    """

    name: str
    xyz_m: FloatArray
    colors: Sequence[str]
    lengths: Sequence[int] = ()
    labels: Sequence[str] = ()
    size_px: float = 5.0
    shown: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "xyz_m", float_array(f"scene: {self.name}", self.xyz_m, (None, 3)))
        count = len(self.xyz_m)
        fits = len(self.colors) in (1, count) and len(self.labels) in (0, count)
        if not fits or (len(self.lengths) > 0 and sum(self.lengths) != count):
            raise InputError(
                f"scene: {self.name}: {len(self.colors)} colours, {len(self.labels)} labels and lines of "
                f"{sum(self.lengths)} vertices for {count} points"
            )


def scene(groups: Sequence[SceneGroup], *, name: str, note: str = "", height_px: int = 620) -> Html:
    """Return a scene that turns with the pointer and grows with the wheel.

    name: What it shows, for those who cannot see it and as the place of its script; letters, digits and hyphens.
    note: A line under it.
    Returns: Canvas, legend and script.
    InputError: There is nothing to show.
    """
    everything = np.concatenate([group.xyz_m for group in groups]) if groups else np.zeros((0, 3))
    if not len(everything):
        raise InputError("scene: there is nothing to show")
    low, high = everything.min(axis=0), everything.max(axis=0)
    size = max(float(np.linalg.norm(high - low)), 1e-12)
    digits = int(np.ceil(-np.log10(size * _DIGITS_SHARE)))
    content = {
        "middle": np.round(0.5 * (low + high), digits).tolist(),
        "size": size,
        "groups": [_content(group, digits) for group in groups],
    }
    # "</" would end the script; JSON has no other sign that HTML could mistake.
    data = json.dumps(content, separators=(",", ":"), ensure_ascii=True).replace("</", "<\\/")
    return Html(
        f'<div class="scene" id="scene-{name}"><canvas role="img" aria-label="{name}" tabindex="0" '
        f'style="width:100%;height:{height_px}px;touch-action:none;cursor:grab;border:1px solid #dfe3e8;'
        f'border-radius:6px"></canvas><div class="legend" style="display:flex;flex-wrap:wrap;gap:.2em 1.4em;'
        f'font-size:.88em;padding:.3em 0"></div><p class="caption">{note}</p>'
        f'<script type="application/json">{data}</script><script>{_SCRIPT % json.dumps("scene-" + name)}</script></div>'
    )


def _content(group: SceneGroup, digits: int) -> dict[str, Any]:
    return {
        "name": group.name,
        "xyz": np.round(group.xyz_m, digits).ravel().tolist(),
        "colors": list(group.colors),
        "lengths": list(group.lengths),
        "labels": list(group.labels),
        "size": group.size_px,
        "shown": group.shown,
    }


_SCRIPT = r"""
(function () {
  var box = document.getElementById(%s), canvas = box.querySelector("canvas"), legend = box.querySelector(".legend");
  var data = JSON.parse(box.querySelector('script[type="application/json"]').textContent);
  var azimuth = -0.9, elevation = 0.5, zoom = 1, shiftX = 0, shiftY = 0, pointer = null;
  var context = canvas.getContext("2d");
  data.groups.forEach(function (group) {
    var label = document.createElement("label"), tick = document.createElement("input");
    tick.type = "checkbox"; tick.checked = group.shown;
    tick.onchange = function () { group.shown = tick.checked; draw(); };
    var mark = document.createElement("span");
    mark.textContent = group.lengths.length ? "\u2014 " : "\u25cf "; mark.style.color = group.colors[0];
    label.append(tick, mark, group.name); legend.append(label);
  });
  var hint = document.createElement("span");
  hint.textContent = "drag: turn \u00b7 wheel: zoom \u00b7 shift + drag: move \u00b7 double click: reset";
  hint.style.color = "#66717d"; legend.append(hint);
  function view(width, height) {
    var ca = Math.cos(azimuth), sa = Math.sin(azimuth), ce = Math.cos(elevation), se = Math.sin(elevation);
    var scale = zoom * 0.92 * Math.min(width, 1.3 * height) / data.size, m = data.middle;
    return { scale: scale, at: function (x, y, z) {
      x -= m[0]; y -= m[1]; z -= m[2];
      var right = -sa * x + ca * y, out = ca * x + sa * y;
      return [width / 2 + shiftX + scale * right, height / 2 + shiftY - scale * (ce * z - se * out), ce * out + se * z];
    } };
  }
  function niceLength(most) {
    var power = Math.pow(10, Math.floor(Math.log10(most))), steps = [5, 2, 1];
    for (var i = 0; i < 3; i++) if (steps[i] * power <= most) return steps[i] * power;
    return power;
  }
  function ruler(look, width, height) {
    var length = niceLength(0.25 * width / look.scale), long = length * look.scale;
    context.strokeStyle = context.fillStyle = "#1f2a36"; context.lineWidth = 2;
    context.beginPath(); context.moveTo(20, height - 18); context.lineTo(20 + long, height - 18); context.stroke();
    context.fillText(+length.toPrecision(2) + " m", 20, height - 26);
    var arm = 34 / look.scale, m = data.middle, zero = look.at(m[0], m[1], m[2]);
    ["x", "y", "z"].forEach(function (axis, i) {
      var tip = m.slice(); tip[i] += arm; tip = look.at(tip[0], tip[1], tip[2]);
      var x = width - 60 + tip[0] - zero[0], y = height - 60 + tip[1] - zero[1];
      context.lineWidth = 1.5; context.beginPath(); context.moveTo(width - 60, height - 60); context.lineTo(x, y);
      context.stroke(); context.fillText(axis, x + (x - width + 60) * 0.25 - 3, y + (y - height + 60) * 0.25 + 4);
    });
  }
  function drawLines(group, look) {
    var first = 0, xyz = group.xyz;
    context.strokeStyle = group.colors[0]; context.lineWidth = group.size; context.globalAlpha = 0.75;
    context.beginPath();
    group.lengths.forEach(function (count) {
      for (var i = 0; i < count; i++) {
        var at = look.at(xyz[3 * (first + i)], xyz[3 * (first + i) + 1], xyz[3 * (first + i) + 2]);
        if (i) context.lineTo(at[0], at[1]); else context.moveTo(at[0], at[1]);
      }
      first += count;
    });
    context.stroke(); context.globalAlpha = 1;
  }
  function drawPoints(group, look) {
    var xyz = group.xyz, order = [], near = null;
    for (var i = 0; i < xyz.length / 3; i++) {
      var at = look.at(xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2]); at.push(i); order.push(at);
    }
    order.sort(function (a, b) { return a[2] - b[2]; });
    order.forEach(function (at) {
      context.fillStyle = group.colors[group.colors.length > 1 ? at[3] : 0];
      context.beginPath(); context.arc(at[0], at[1], group.size / 2, 0, 7); context.fill();
      if (pointer && group.labels.length) {
        var away = Math.hypot(at[0] - pointer[0], at[1] - pointer[1]);
        if (away < 9 && (!near || away <= near[0])) near = [away, at, group.labels[at[3]]];
      }
    });
    return near;
  }
  function draw() {
    var width = canvas.clientWidth, height = canvas.clientHeight, ratio = window.devicePixelRatio || 1;
    canvas.width = width * ratio; canvas.height = height * ratio;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.fillStyle = "#fff"; context.fillRect(0, 0, width, height);
    context.font = "13px system-ui, 'DejaVu Sans', sans-serif";
    var look = view(width, height), near = null;
    data.groups.forEach(function (group) { if (group.shown && group.lengths.length) drawLines(group, look); });
    data.groups.forEach(function (group) {
      if (group.shown && !group.lengths.length) near = drawPoints(group, look) || near;
    });
    ruler(look, width, height);
    if (near) {
      var wide = context.measureText(near[2]).width, x = Math.min(near[1][0] + 10, width - wide - 12);
      context.fillStyle = "rgba(255,255,255,.92)"; context.fillRect(x - 4, near[1][1] - 26, wide + 8, 20);
      context.fillStyle = "#1f2a36"; context.fillText(near[2], x, near[1][1] - 12);
    }
  }
  var drag = null;
  canvas.onpointerdown = function (event) {
    drag = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId);
  };
  canvas.onpointerup = function () { drag = null; };
  canvas.onpointermove = function (event) {
    var area = canvas.getBoundingClientRect();
    pointer = [event.clientX - area.left, event.clientY - area.top];
    if (drag) {
      var dx = event.clientX - drag[0], dy = event.clientY - drag[1];
      drag = [event.clientX, event.clientY];
      if (event.shiftKey) { shiftX += dx; shiftY += dy; } else {
        azimuth -= 0.008 * dx; elevation = Math.max(-1.57, Math.min(1.57, elevation + 0.008 * dy));
      }
    }
    draw();
  };
  canvas.onpointerleave = function () { pointer = null; draw(); };
  canvas.addEventListener("wheel", function (event) {
    event.preventDefault(); zoom *= Math.exp(-0.0015 * event.deltaY); draw();
  }, { passive: false });
  canvas.ondblclick = function () { azimuth = -0.9; elevation = 0.5; zoom = 1; shiftX = shiftY = 0; draw(); };
  canvas.onkeydown = function (event) {
    var turns = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    if (turns) { azimuth += turns[0]; elevation += turns[1]; event.preventDefault(); draw(); }
  };
  window.addEventListener("resize", draw); draw();
}());
"""
