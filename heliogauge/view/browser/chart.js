"use strict";
// Charts: lines with sigma bands, points, bars and steps; the value nearest to the pointer is shown.
(() => {
  const HEIGHT = 340;
  const EQUAL_HEIGHT = 460;
  // Pointer further than this from a value shows none [px].
  const REACH = 40;
  const KEYS = "Pointer: the nearest value. Drag moves; the wheel zooms once the chart was clicked (or with Ctrl), two fingers "
    + "always. Keys: left and right to the neighbouring value, up and down to the next series, + and \u2212 zoom, 0 shows all.";

  const superscript = (text) => text.replace(/[-0-9]/g, (one) => one === "-" ? "\u207b" : "\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079"[one]);

  // The axis holds the logarithm, so that zooming is even on it.
  function logLabel(value) {
    return Math.abs(value - Math.round(value)) < 1e-6
      ? `10${superscript(String(Math.round(value)))}` : heliogauge.number(10 ** value, 2);
  }

  function extentOf(arrays) {
    let low = Infinity;
    let high = -Infinity;
    for (const array of arrays) {
      for (const value of array) {
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    return low <= high ? [low, high] : [0, 1];
  }

  function widened([low, high], share) {
    const spare = (high - low) * share || Math.abs(low) * 0.05 || 0.5;
    return [low - spare, high + spare];
  }

  // Pieces without a gap: [first, last + 1] each.
  function pieces(...arrays) {
    const found = [];
    let first = -1;
    for (let index = 0; index <= arrays[0].length; index++) {
      const known = index < arrays[0].length && arrays.every((array) => Number.isFinite(array[index]));
      if (known && first < 0) first = index;
      if (!known && first >= 0) {
        found.push([first, index]);
        first = -1;
      }
    }
    return found;
  }

  class Chart {
    // content: {name, note, x_label, y_label, equal, x_log, y_log, x_counts, x_from, y_down, series: [{name, x, y, sigma, ...}]} with
    // numbers as arrays; x_from: x are seconds after this time since 1970. at(series, index) is told which value is shown; null where none is.
    constructor(place, content, at = () => {}) {
      this.place = place;
      this.at = at;
      this.hidden = new Set();
      this.content = content;
    }

    async begin() {
      this.legendPlace = heliogauge.element("div");
      this.place.append(this.legendPlace);
      this.figure = await heliogauge.figure(this.place, `${this.content.name}. Values by arrow keys.`, KEYS);
      this.readout = heliogauge.element("output", { class: "view-readout", "aria-live": "off" });
      this.figure.root.after(this.readout);
      this.figure.onResize = () => this.draw();
      this.figure.onZoom = () => this.point(null);
      this.figure.root.addEventListener("pointermove", (event) => this.pointer(event));
      this.figure.root.addEventListener("pointerleave", () => this.point(null));
      this.figure.root.addEventListener("keydown", (event) => this.key(event));
      heliogauge.onTheme(() => this.draw());
      this.show(this.content);
      return this;
    }

    show(content) {
      this.content = content;
      const log = (on) => on ? (value) => value > 0 ? Math.log10(value) : NaN : null;
      const scaled = (values, change) => change ? Float64Array.from(values, change) : values;
      const moment = Number.isFinite(content.x_from) ? (value) => 1000 * (content.x_from + value) : null;
      this.scales = { x: moment || log(content.x_log), y: log(content.y_log) };
      this.series = content.series.map((one) => {
        const part = { ...one, own: one.color, px: scaled(one.x, this.scales.x), py: scaled(one.y, this.scales.y), low: null, high: null };
        if (one.sigma) {
          const side = (sign) => scaled(Float64Array.from(one.y, (value, index) => value + sign * one.sigma[index]), this.scales.y);
          [part.low, part.high] = [side(-1), side(1)];
          // On a logarithmic axis a band that reaches zero ends at its value.
          if (this.scales.y) part.low = part.low.map((value, index) => Number.isNaN(value) ? part.py[index] : value);
        }
        return part;
      });
      if (content.series.length > 1) {
        const entries = content.series.map((one, index) => ({ name: one.name, color: one.color, on: !this.hidden.has(index) }));
        this.legendPlace.replaceChildren(heliogauge.legend(entries, (index, on) => {
          if (on) this.hidden.delete(index);
          else this.hidden.add(index);
          this.draw();
        }, "Series"));
      } else {
        this.legendPlace.replaceChildren();
      }
      this.draw();
    }

    visible() {
      return this.series.filter((_, index) => !this.hidden.has(index));
    }

    draw() {
      const { content, figure } = this;
      const width = figure.root.clientWidth;
      if (!width) return;
      for (const one of this.series) one.color = heliogauge.onPaper(one.own);
      const narrow = width < 480;
      const left = narrow ? 54 : 66;
      const box = { left, top: 10, width: Math.max(width - left - 16, 40), height: HEIGHT - 58 };
      if (content.equal) Object.assign(box, { height: EQUAL_HEIGHT - 58 });
      figure.root.style.height = `${box.height + 58}px`;
      // Switching a series off keeps the axes: what is left does not jump.
      const ends = (one) => one.low ? [one.py, one.low, one.high] : [one.py];
      const bars = this.series.filter((one) => one.mark === "bars");
      const barX = bars.flatMap((one) => {
        const half = this.barWidth(one) / 2;
        const [low, high] = extentOf([one.px]);
        return [[low - half, high + half]];
      });
      const reach = extentOf([...this.series.map((one) => one.px), ...barX]);
      let x = content.x_counts ? [reach[0] - 0.5, reach[1] + 0.5] : widened(reach, 0.03);
      let y = widened(extentOf([...this.series.flatMap(ends), ...(bars.length && !this.scales.y ? [[0]] : [])]), 0.05);
      if (bars.length && !this.scales.y && extentOf(bars.map((one) => one.py))[0] >= 0 && y[0] < 0) y = [0, y[1]];
      if (content.background) [x, y] = [content.background.extent.slice(0, 2), content.background.extent.slice(2)];
      if (content.equal) {
        const proportion = Math.max((x[1] - x[0]) / (y[1] - y[0]), 0.7);
        box.width = Math.min(box.width, box.height * proportion);
        [x, y] = this.equalRanges(x, y, box);
      }
      const format = (log) => log ? { formatter: logLabel } : { formatter: heliogauge.tick };
      const color = heliogauge.colors();
      const labels = (log) => ({ color: color.ink, hideOverlap: true, showMinLabel: false, showMaxLabel: false, ...format(log) });
      const isTime = Number.isFinite(content.x_from);
      const xLabel = isTime ? { color: color.ink, hideOverlap: true } : labels(content.x_log);
      const option = figure.axes(box, x, y, {
        xName: content.x_label, yName: content.y_label, yDown: content.y_down,
        xAxis: { type: isTime ? "time" : "value", axisLabel: xLabel, splitNumber: narrow ? 4 : 8, nameGap: 26, minInterval: content.x_counts ? 1 : 0 },
        yAxis: { axisLabel: labels(content.y_log), nameGap: narrow ? 38 : 48 },
      });
      const behind = content.background ? [this.custom([content.background.extent.slice(1, 3)], 1, (api) => this.picture(api))] : [];
      option.series = behind.concat(this.series.flatMap((one, index) => this.hidden.has(index) ? [] : this.parts(one, index)));
      if (this.visible().some((one) => one.names)) option.series.push(this.names(this.visible()));
      option.useUTC = true;
      figure.chart.setOption(option, { replaceMerge: ["series"] });
    }

    // The picture behind the series.
    picture(api) {
      const { image, extent } = this.content.background;
      const [left, top] = api.coord([extent[0], extent[3]]);
      const [right, bottom] = api.coord([extent[1], extent[2]]);
      return { type: "image", style: { image, x: left, y: top, width: right - left, height: bottom - top } };
    }

    equalRanges(x, y, box) {
      const scale = Math.max((x[1] - x[0]) / box.width, (y[1] - y[0]) / box.height);
      return [[x, box.width], [y, box.height]].map(([[low, high], size]) => {
        const middle = (low + high) / 2;
        return [middle - scale * size / 2, middle + scale * size / 2];
      });
    }

    barWidth(one) {
      const sorted = Float64Array.from(one.px).filter(Number.isFinite).sort();
      let least = Infinity;
      for (let index = 1; index < sorted.length; index++) {
        if (sorted[index] > sorted[index - 1]) least = Math.min(least, sorted[index] - sorted[index - 1]);
      }
      return Number.isFinite(least) ? 0.95 * least : 1;
    }

    parts(one, index) {
      const z = 3 + index;
      const data = Array.from(one.px, (x, at) => [x, one.py[at]]);
      if (one.mark === "bars") {
        const width = this.barWidth(one);
        return [this.custom(data, z, (api, at) => {
          const [left, top] = api.coord([one.px[at] - width / 2, one.py[at]]);
          const [right, bottom] = api.coord([one.px[at] + width / 2, this.scales.y ? this.figure.y[0] : 0]);
          return { type: "rect", shape: { x: left, y: Math.min(top, bottom), width: right - left, height: Math.abs(bottom - top) },
            style: { fill: one.color } };
        })];
      }
      const made = [];
      if (one.mark === "points") {
        if (one.low) {
          made.push(this.custom(data, z - 0.5, (api, at) => {
            const [x, low] = api.coord([one.px[at], one.low[at]]);
            const [, high] = api.coord([one.px[at], one.high[at]]);
            return { type: "line", shape: { x1: x, y1: low, x2: x, y2: high }, style: { stroke: one.color, lineWidth: 1 } };
          }));
        }
        made.push({ type: "scatter", data, symbolSize: Math.max(one.size * 1.3, 3), itemStyle: { color: one.color }, z,
          silent: true, large: data.length > 5000 && !one.names, clip: true });
        return made;
      }
      if (one.low) made.push(this.band(one, z - 0.5));
      made.push({ type: "line", data, z, silent: true, showSymbol: data.length === 1, clip: true,
        step: one.mark === "steps" ? "middle" : false,
        lineStyle: { color: one.color, width: one.size, type: one.dashed ? "dashed" : "solid" }, itemStyle: { color: one.color } });
      return made;
    }

    band(one, z) {
      const parts = pieces(one.px, one.low, one.high);
      return this.custom(parts.map(([first]) => [one.px[first], one.py[first]]), z, (api, at) => {
        const [first, end] = parts[at];
        const points = [];
        for (let index = first; index < end; index++) points.push(api.coord([one.px[index], one.high[index]]));
        for (let index = end - 1; index >= first; index--) points.push(api.coord([one.px[index], one.low[index]]));
        return { type: "polygon", shape: { points }, style: { fill: one.color, opacity: 0.25 } };
      });
    }

    // Names beside points, where they cover neither each other nor a point; what has no room is read with the pointer.
    names(shown) {
      const all = shown.flatMap((one) => Array.from(one.names || [], (name, at) => ({ name, x: one.px[at], y: one.py[at], size: one.size }))
        .filter(({ name }) => name));
      const { ink } = heliogauge.colors();
      const points = shown.filter((one) => one.mark === "points").flatMap((one) => Array.from(one.px, (x, at) => [x, one.py[at], one.size]));
      let taken = [];
      return this.custom(all.map(({ x, y }) => [x, y]), 3 + this.series.length, (api, at, room) => {
        if (at === 0) taken = points.map(([x, y, size]) => [...api.coord([x, y]), size * 1.3, size * 1.3]);
        const { name, x, y, size } = all[at];
        const [left, top] = api.coord([x, y]);
        const away = size * 0.65 + 3;
        const [wide, high] = [6.4 * name.length, 12];
        // Above and below names stay within the box; where both are taken, a line farther.
        const level = Math.min(Math.max(left, room.x + wide / 2 + 1), room.x + room.width - wide / 2 - 1) - left;
        const near = away + high / 2;
        const places = [[away + wide / 2, 0], [-away - wide / 2, 0], [level, -near], [level, near], [level, -near - high], [level, near + high]];
        const inside = ([across, along]) => left + across - wide / 2 > room.x && left + across + wide / 2 < room.x + room.width
          && top + along - high / 2 > room.y && top + along + high / 2 < room.y + room.height;
        const free = ([across, along]) => taken.every(([a, b, w, h]) =>
          Math.abs(left + across - a) >= (wide + w) / 2 || Math.abs(top + along - b) >= (high + h) / 2);
        const place = places.find((one) => inside(one) && free(one));
        if (!place) return null;
        const [middle, line] = [left + place[0], top + place[1]];
        taken.push([middle, line, wide, high]);
        return { type: "text", style: { text: name, x: middle, y: line, align: "center", verticalAlign: "middle", fill: ink, fontSize: 11 } };
      });
    }

    custom(data, z, shapeOf) {
      return { type: "custom", data, z, silent: true, clip: true, renderItem: (params, api) => shapeOf(api, params.dataIndex, params.coordSys) };
    }

    // ---- the value that is shown ----

    pointer(event) {
      const { left, top, within } = this.figure.placeOf(event);
      const nearest = within ? this.nearest(left, top) : null;
      this.readout.setAttribute("aria-live", "off");
      this.point(nearest);
    }

    nearest(left, top) {
      const { figure } = this;
      const [x0, y0] = figure.toPixel(0, 0);
      const [x1, y1] = figure.toPixel(1, 1);
      let best = null;
      let least = REACH ** 2;
      for (const one of this.visible()) {
        // Lines and bars are asked along x, points in both directions.
        const flat = one.mark === "points" ? 1 : 0.02;
        for (let index = 0; index < one.px.length; index++) {
          const across = x0 + one.px[index] * (x1 - x0) - left;
          const along = y0 + one.py[index] * (y1 - y0) - top;
          const distance = across * across + flat * along * along;
          if (distance < least) {
            least = distance;
            best = { one, index };
          }
        }
      }
      return best;
    }

    point(found) {
      this.found = found;
      if (!found) {
        this.figure.drawOver([]);
        this.figure.hideTip();
        this.readout.textContent = "";
        this.at(null);
        return;
      }
      const { one, index } = found;
      const [left, top] = this.figure.toPixel(one.px[index], one.py[index]);
      const color = heliogauge.colors();
      this.figure.drawOver([["circle", { cx: left, cy: top, r: 5, fill: one.color, stroke: color.paper, "stroke-width": 2 }]]);
      const words = this.words(found);
      this.figure.showTip(left, top, ...words);
      this.readout.textContent = words.join("; ");
      this.at(index);
    }

    words({ one, index }) {
      const { content } = this;
      const split = (label) => (/^(.*?)\s*(?:\[([^\]]*)\])?$/.exec(label) || []).slice(1);
      const [xName, xUnit] = split(content.x_label);
      const [yName, yUnit] = split(content.y_label);
      const lines = [];
      if (this.series.length > 1) lines.push(one.name);
      if (one.labels?.[index]) lines.push(one.labels[index]);
      const when = Number.isFinite(content.x_from) ? new Date(one.px[index]).toISOString().slice(0, 16).replace("T", " ") : "";
      lines.push(`${xName} ${when || heliogauge.number(one.x[index])}${xUnit ? ` ${xUnit}` : ""}`);
      lines.push(`${yName} ${heliogauge.withSigma(one.y[index], one.sigma ? one.sigma[index] : NaN, yUnit)}`);
      return lines;
    }

    key(event) {
      const { figure } = this;
      const middle = [figure.box.left + figure.box.width / 2, figure.box.top + figure.box.height / 2];
      const steps = { ArrowRight: [0, 1], ArrowLeft: [0, -1], ArrowUp: [-1, 0], ArrowDown: [1, 0] };
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.key === "+" || event.key === "=") figure.zoomBy(1.5, ...middle);
      else if (event.key === "-") figure.zoomBy(1 / 1.5, ...middle);
      else if (event.key === "0") figure.reset();
      else if (event.key === "Escape") this.point(null);
      else if (steps[event.key]) this.step(...steps[event.key]);
      else return;
      event.preventDefault();
    }

    step(series, along) {
      const shown = this.visible();
      if (!shown.length) return;
      let { one, index } = this.found || { one: shown[0], index: -1 };
      if (series) {
        const x = one.px[Math.max(index, 0)];
        one = shown[(shown.indexOf(one) + series + shown.length) % shown.length];
        index = 0;
        one.px.forEach((value, at) => { if (Math.abs(value - x) < Math.abs(one.px[index] - x)) index = at; });
      } else {
        const known = (at) => Number.isFinite(one.px[at]) && Number.isFinite(one.py[at]);
        let next = index + along;
        while (next >= 0 && next < one.px.length && !known(next)) next += along;
        if (next < 0 || next >= one.px.length) return;
        index = next;
      }
      this.figure.follow(one.px[index], one.py[index]);
      this.readout.setAttribute("aria-live", "polite");
      this.point({ one, index });
    }
  }

  heliogauge.drawChart = (place, content, at) => new Chart(place, content, at).begin();

  heliogauge.kind("chart", async (place, spec) => {
    const series = await Promise.all(spec.series.map(async (one) => ({
      ...one,
      x: await heliogauge.numbers(one.x),
      y: await heliogauge.numbers(one.y),
      sigma: one.sigma ? await heliogauge.numbers(one.sigma) : null,
      labels: await heliogauge.lines(one.labels),
      names: one.names ? await heliogauge.lines(one.names) : null,
    })));
    place.append(heliogauge.element("p", { class: "view-title" }, spec.name));
    const { background } = spec;
    if (background) background.image = await heliogauge.image(background.image);
    const chart = await heliogauge.drawChart(place, { ...spec, series });
    if (spec.note) place.append(heliogauge.element("p", { class: "view-note" }, spec.note));
    return { chart };
  });
})();
