"use strict";
// Maps: values with sigma and flags under the pointer, layers, colour range, sections, tilt and focus removed live.
(() => {
  const FLAGS = "flags";
  // A tall mirror fills at most this share of the screen.
  const MOST_HEIGHT = 0.56;
  const REMOVAL_NAMES = { nothing: "nothing", tilt: "tilt", focus: "tilt and focus", quadratic: "tilt, focus, twist" };
  const KEYS = "Pointer: value, sigma and flags. Drag moves; the wheel zooms once the map was clicked (or with Ctrl), two "
    + "fingers always; double click shows all. Section: press the button, or hold Shift, and drag a line. Keys: arrows move "
    + "the pointer by a node (Shift: by ten), + and \u2212 zoom about it, 0 shows all, 1 to 9 choose the layer, F shows the "
    + "flags, R removes the next of tilt, focus and quadratic, H and V cut a section along x and along y, S begins and ends "
    + "a section at the pointer, Escape removes it.";

  // A number for an input: no more digits than are seen.
  const rounded = (value) => Number(value.toPrecision(4));

  class MapOfLayers {
    constructor(place, spec) {
      Object.assign(this, { place, spec, mode: "figure" });
      this.unit = spec.axis_unit;
      this.names = spec.axis_names;
      this.isFront = !spec.y_down && this.names[0] === "x";
      this.pixels = [document.createElement("canvas"), document.createElement("canvas")];
      this.marked = new Set(); // bits that are painted on other layers
      this.unmarked = new Set(); // bits that are not painted on the layer of flags
    }

    async begin() {
      const { spec } = this;
      this.data = await heliogauge.mapData(spec);
      this.buildControls();
      const orientation = spec.y_down ? "y down" : this.isFront ? "seen from the front, y up" : `${this.names[1]} up`;
      this.figure = await heliogauge.figure(this.body, `Map: ${spec.name}, x to the right, ${orientation}. Arrow keys read values.`, KEYS);
      this.figure.leastSpan = Math.min(100 * 8 / Math.max(this.data.columns, this.data.rows), 100);
      this.readout = heliogauge.element("output", { class: "view-readout", "aria-live": "off" }, "Move the pointer over the map.");
      this.summary = heliogauge.element("p", { class: "view-note" });
      this.figure.root.after(this.readout, this.summary);
      this.figure.onResize = () => this.draw();
      this.figure.onZoom = () => this.zoomed();
      this.listen();
      heliogauge.onTheme(() => { this.paintLegend(); this.draw(); });
      await this.choose(spec.layers[0].key);
    }

    // ---- controls ----

    buildControls() {
      const { spec } = this;
      const make = heliogauge.element;
      const layers = [...spec.layers.map((one) => [one.key, one.name]), ...(this.data.flags.length ? [[FLAGS, "Flags"]] : [])];
      const option = ([value, name]) => make("option", { value }, name);
      this.layerSelect = make("select", { "aria-label": "Layer", change: () => this.choose(this.layerSelect.value) }, ...layers.map(option));
      const words = [...new Set(this.data.removals.flatMap((one) => one.parts.map((part) => part.removal)))];
      this.removalSelect = make("select", { "aria-label": "Remove", change: () => this.remove(this.removalSelect.value) },
        ...words.map((word) => option([word, REMOVAL_NAMES[word] || word])));
      this.numbersLine = make("output", { class: "view-numbers", "aria-live": "polite" });
      const modes = [["figure", "as in print"], ["0.99", "99 % of the values"], ["0.95", "95 % of the values"],
        ["0.9", "90 % of the values"], ["1", "all values"], ["hand", "by hand"]];
      this.modeSelect = make("select", { "aria-label": "Range of colours", change: () => this.chooseMode(this.modeSelect.value) }, ...modes.map(option));
      const input = (label) => make("input", { type: "number", step: "any", "aria-label": label, change: () => this.byHand() });
      [this.lowInput, this.highInput] = [input("Colours from"), input("Colours to")];
      this.unitText = make("span", { class: "view-note" });
      this.sectionButton = make("button", { type: "button", "aria-pressed": "false", click: () => this.sectioning(!this.drawsSection) }, "Section");
      const reset = make("button", { type: "button", click: () => this.figure.reset() }, "Show all");
      this.legendPlace = make("div");
      this.body = make("div");
      this.sectionPlace = make("div", { class: "view-section" });
      this.colorsBar = make("div", { class: "view-bar" }, make("label", {}, "Colours", this.modeSelect),
        make("label", {}, "from", this.lowInput), make("label", {}, "to", this.highInput), this.unitText);
      // Beside a mirror that is not much wider than high there is room for its sections and flags.
      const beside = this.data.ends.x[1] - this.data.ends.x[0] < 1.35 * (this.data.ends.y[1] - this.data.ends.y[0]);
      const side = make("div", {}, this.legendPlace, this.sectionPlace);
      this.place.append(
        make("p", { class: "view-title" }, spec.name),
        make("div", { class: "view-bar" }, layers.length > 1 ? make("label", {}, "Layer", this.layerSelect) : null, this.sectionButton, reset),
        ...(words.length > 1 ? [make("div", { class: "view-bar" }, make("label", {}, "Remove", this.removalSelect), this.numbersLine)] : []),
        this.colorsBar, make("div", { class: beside ? "view-map beside" : "view-map" }, this.body, side),
        ...(spec.note ? [make("p", { class: "view-note" }, spec.note)] : []),
      );
      this.paintLegend();
      this.showNumbers();
    }

    get painted() {
      const all = this.data.flags.map((one) => one.word);
      return new Set(all.filter((word) => this.key === FLAGS ? !this.unmarked.has(word) : this.marked.has(word)));
    }

    paintLegend() {
      const share = (one) => one.share >= 0.001 ? `${(100 * one.share).toFixed(1)} %` : `${one.count} ${one.count === 1 ? "node" : "nodes"}`;
      const painted = this.painted;
      const entries = this.data.flags.map((one) => ({ name: `${one.word}: ${share(one)}`, color: one.color, on: painted.has(one.word),
        note: `${one.count} nodes of the mirror` }));
      const legend = heliogauge.legend(entries, (index, on) => {
        const set = this.key === FLAGS ? this.unmarked : this.marked;
        if (on === (this.key === FLAGS)) set.delete(this.data.flags[index].word);
        else set.add(this.data.flags[index].word);
        this.draw();
      }, "Flags painted on the map");
      const hatched = heliogauge.element("span", { class: "view-swatch view-hatched" });
      if (this.data.flags.length) legend.prepend("Paint by flag:");
      if (this.data.hasGaps) legend.prepend(heliogauge.element("span", {}, hatched, "no value there."));
      this.legendPlace.replaceChildren(legend);
    }

    showNumbers() {
      const texts = this.data.removals.flatMap((set) => {
        const part = set.parts.find((one) => one.removal === this.data.removal);
        if (!part) return [];
        const numbers = part.numbers.map(([name, text]) => `${name} ${text}`).join("   ");
        return [`${set.name ? `${set.name}: ` : ""}${numbers}`];
      });
      this.numbersLine.replaceChildren(...texts.map((text) => heliogauge.element("span", {}, text)));
      const part = this.data.removals[0]?.parts.find((one) => one.removal === this.data.removal);
      this.numbersLine.title = part ? `removed: ${part.removed}; deviation from: ${part.reference}` : "";
    }

    // ---- choices ----

    async choose(key) {
      const layer = key === FLAGS ? this.layer : this.spec.layers.find((one) => one.key === key);
      if (!(await this.data.take(layer))) return; // the reader has chosen another meanwhile
      if (this.layer !== layer && this.mode === "hand") this.mode = "figure";
      Object.assign(this, { key, layer });
      this.layerSelect.value = key;
      this.unitText.textContent = layer.unit;
      this.colorsBar.hidden = key === FLAGS;
      this.paintLegend();
      await this.renew();
    }

    async remove(removal) {
      this.data.removal = removal;
      this.removalSelect.value = removal;
      this.showNumbers();
      if (await this.data.take(this.layer)) await this.renew();
    }

    async renew() {
      this.figure.hideTip();
      await this.chooseMode(this.mode);
      if (this.pointer) this.show(this.pointer);
      if (this.section) await this.drawSection();
    }

    // Sets where the colours begin and end.
    async chooseMode(mode) {
      this.mode = mode;
      this.modeSelect.value = mode;
      if (mode !== "hand") {
        [this.low, this.high] = await this.data.range(mode);
        this.lowInput.value = rounded(this.low);
        this.highInput.value = rounded(this.high);
      }
      this.draw();
    }

    byHand() {
      const [low, high] = [this.lowInput.valueAsNumber, this.highInput.valueAsNumber];
      const wrong = !(high > low);
      this.lowInput.toggleAttribute("aria-invalid", wrong);
      this.highInput.toggleAttribute("aria-invalid", wrong);
      if (wrong) return;
      Object.assign(this, { low, high, mode: "hand" });
      this.modeSelect.value = "hand";
      this.draw();
    }

    // ---- drawing ----

    layout() {
      const width = this.figure.root.clientWidth;
      const narrow = width < 480;
      const left = narrow ? 50 : 64;
      const right = narrow ? 72 : 92;
      const most = { width: width - left - right, height: Math.max(MOST_HEIGHT * innerHeight, 260) };
      const size = { x: this.data.ends.x[1] - this.data.ends.x[0], y: this.data.ends.y[1] - this.data.ends.y[0] };
      const scale = Math.min(most.width / size.x, most.height / size.y); // pixels for each metre
      const box = { left, top: 8, width: Math.max(size.x * scale, 110), height: Math.max(size.y * scale, 110) };
      // Axes of a long trough leave room beside it rather than squeeze their labels.
      const around = ([low, high], pixels) => {
        const spare = (pixels / scale - (high - low)) / 2;
        return [low - spare, high + spare];
      };
      return { box, x: around(this.data.ends.x, box.width), y: around(this.data.ends.y, box.height), narrow };
    }

    draw() {
      if (!this.layer || !this.figure.root.clientWidth) return;
      const { box, x, y, narrow } = this.layout();
      this.shades = heliogauge.mapPicture.shadesOf(this.layer, this.low, this.high);
      const color = heliogauge.colors();
      const root = this.figure.root;
      root.style.height = `${box.height + 54}px`;
      this.figure.chart.resize();
      const labels = { formatter: heliogauge.tick };
      const option = this.figure.axes(box, x, y, {
        xName: `${this.names[0]} [${this.unit}]${!this.isFront ? "" : narrow ? "  from the front" : "   seen from the front"}`, yName: `${this.names[1]} [${this.unit}]`, yDown: this.spec.y_down,
        xAxis: { splitLine: { show: false }, splitNumber: Math.max(Math.round(box.width / 90), 2), axisLabel: { color: color.ink, hideOverlap: true, showMinLabel: false, showMaxLabel: false, ...labels }, nameGap: 26 },
        yAxis: { splitLine: { show: false }, splitNumber: Math.max(Math.round(box.height / 60), 2), axisLabel: { color: color.ink, showMinLabel: false, showMaxLabel: false, ...labels }, nameGap: narrow ? 34 : 44 },
      });
      const bar = this.key !== FLAGS;
      // Even steps that end with the colours where their numbers are short; otherwise round numbers between.
      const interval = (this.high - this.low) / (box.height > 250 ? 8 : 4);
      const even = Math.abs(interval - Number(interval.toPrecision(2))) < 1e-9 * interval;
      option.grid.push({ left: box.left + box.width + 12, top: box.top, width: 14, height: box.height, show: false });
      option.xAxis.push({ gridIndex: 1, type: "value", min: 0, max: 1, show: false });
      option.yAxis.push(heliogauge.axis(this.layer.unit ? `[${this.layer.unit}]` : "", { gridIndex: 1, position: "right", show: bar, min: this.low, max: this.high,
        interval: even ? interval : null, nameGap: narrow ? 38 : 50, splitLine: { show: false }, axisLine: { show: false },
        axisLabel: { color: color.ink, formatter: heliogauge.tick, showMinLabel: even, showMaxLabel: even } }));
      const custom = (axis, renderItem) => ({ type: "custom", xAxisIndex: axis, yAxisIndex: axis, data: [[0, 0]], silent: true, clip: true, renderItem });
      option.series = [custom(0, () => this.picture()), custom(0, (_, api) => this.outlines(api)), custom(0, (_, api) => this.overlays(api)),
        ...(bar ? [custom(1, (_, api) => this.colorBar(api))] : [])];
      this.figure.chart.setOption(option, { replaceMerge: ["series"] });
      this.over();
      this.summarise();
    }

    // Edges of panels and the like, as vertices in the unit of the axes.
    outlines(api) {
      const style = { stroke: heliogauge.colors().faint, lineWidth: 1, fill: "none" };
      return { type: "group", children: this.spec.lines.map((line) => ({ type: "polyline", silent: true, style,
        shape: { points: line.map((vertex) => api.coord(vertex)) } })) };
    }

    // Arrows and dots with words, where these have room.
    overlays(api) {
      const children = [];
      const stroke = { stroke: "#111111", lineWidth: 2, fill: "none" };
      const { box } = this.figure;
      const halo = { stroke: "#ffffff", lineWidth: 4, fill: "none", opacity: 0.7 };
      for (const [foot, tip] of this.spec.arrows) {
        const [[x0, y0], [x1, y1]] = [api.coord(foot), api.coord(tip)];
        const length = Math.hypot(x1 - x0, y1 - y0);
        if (length < 1) continue;
        const head = Math.min(0.35 * length, 9);
        const [along, up] = [(x1 - x0) / length * head, (y1 - y0) / length * head];
        const wings = [[x1 - along + 0.5 * up, y1 - up - 0.5 * along], [x1, y1], [x1 - along - 0.5 * up, y1 - up + 0.5 * along]];
        for (const style of [halo, stroke]) {
          children.push({ type: "line", silent: true, style, shape: { x1: x0, y1: y0, x2: x1, y2: y1 } },
            { type: "polyline", silent: true, style, shape: { points: wings } });
        }
      }
      const places = this.spec.marks.map((one) => api.coord(one.place));
      places.forEach(([x, y], index) => {
        children.push({ type: "circle", silent: true, shape: { cx: x, cy: y, r: 2.5 }, style: { fill: "#111111", stroke: "#ffffff", lineWidth: 1 } });
        // Room to the nearest dot of the same line, on the side where there is more of it; words need not share the edge.
        const gap = (side, end) => Math.min(...places.filter((other) => Math.abs(other[1] - y) < 12 && side * (other[0] - x) > 1)
          .map((other) => side * (other[0] - x)), Math.max(2 * side * (end - x), 0));
        const [right, left] = [gap(1, box.left + box.width), gap(-1, box.left)];
        const { text } = this.spec.marks[index];
        if (Math.max(right, left) < 2 * 6.2 * text.length) return;
        children.push({ type: "text", silent: true, style: { text, x: x + (left > right ? -5 : 5), y, align: left > right ? "right" : "left",
          verticalAlign: "middle", font: "11px system-ui, sans-serif", fill: "#111111", stroke: "#ffffff", lineWidth: 2.5 } });
      });
      return { type: "group", children };
    }

    // The words of the dot that the pointer is at.
    wordsAt(left, top) {
      const near = this.spec.marks.map((one) => {
        const [x, y] = this.figure.toPixel(...one.place);
        return Math.hypot(x - left, y - top);
      });
      const nearest = near.indexOf(Math.min(...near));
      return nearest >= 0 && near[nearest] < 14 ? this.spec.marks[nearest].words : "";
    }

    colorBar(api) {
      const [left, top] = api.coord([0, this.high]);
      const [right, bottom] = api.coord([1, this.low]);
      const image = heliogauge.mapPicture.bar(this.shades);
      return { type: "image", style: { image, x: left, y: top, width: right - left, height: bottom - top } };
    }

    // What is seen of the map, painted anew for each place and size.
    picture() {
      const { box } = this.figure;
      const ratio = Math.min(devicePixelRatio || 1, 2);
      const [width, height] = [Math.max(Math.round(box.width * ratio), 1), Math.max(Math.round(box.height * ratio), 1)];
      // Two canvases by turns, so that the library sees a new picture each time.
      const canvas = this.pixels.reverse()[0];
      [canvas.width, canvas.height] = [width, height];
      const image = new ImageData(width, height);
      const { low, high, shades } = this;
      const look = { low, high, shades, seen: this.figure.seen(), plain: this.key === FLAGS,
        ofCode: heliogauge.mapPicture.flagColors(this.data, this.painted) };
      heliogauge.mapPicture.paint(this.data, look, new Uint32Array(image.data.buffer), width, height, ratio);
      canvas.getContext("2d").putImageData(image, 0, 0);
      return { type: "image", style: { image: canvas, x: box.left, y: box.top, width: box.width, height: box.height } };
    }

    // Pointer and section over the picture.
    over() {
      const color = heliogauge.colors();
      const shapes = [];
      const line = (x1, y1, x2, y2, more) => ["line", { x1, y1, x2, y2, ...more }];
      if (this.section) {
        const [a, b] = [this.figure.toPixel(...this.section[0]), this.figure.toPixel(...this.section[1])];
        shapes.push(line(...a, ...b, { stroke: "#ffffff", "stroke-width": 4, opacity: 0.8 }), line(...a, ...b, { stroke: "#111111", "stroke-width": 1.6 }));
        [a, b].forEach(([cx, cy]) => shapes.push(["circle", { cx, cy, r: 4, fill: "#111111", stroke: "#ffffff", "stroke-width": 1.5 }]));
      }
      if (this.pointer) {
        const [x, y] = this.figure.toPixel(this.spec.x[this.pointer[0]], this.spec.y[this.pointer[1]]);
        shapes.push(["circle", { cx: x, cy: y, r: 5, fill: "none", stroke: "#ffffff", "stroke-width": 3 }],
          ["circle", { cx: x, cy: y, r: 5, fill: "none", stroke: "#111111", "stroke-width": 1.4 }]);
        const { box } = this.figure;
        shapes.push(line(x, box.top + box.height, x, box.top + box.height + 6, { stroke: color.ink, "stroke-width": 2 }),
          line(box.left - 6, y, box.left, y, { stroke: color.ink, "stroke-width": 2 }));
      }
      this.figure.drawOver(shapes);
    }

    zoomed() {
      this.over();
      this.summarise();
    }

    // Mean and RMS of what is seen, once the reader stops moving.
    summarise() {
      clearTimeout(this.waiting);
      this.waiting = setTimeout(() => {
        const { count, mean, rms, least, most, beyond } = this.data.numbersWithin(this.figure.seen(), [this.low, this.high]);
        // All with the decimals of the RMS: a mean of zero is zero.
        const places = Math.min(Math.max(2 - Math.floor(Math.log10(rms || 1)), 0), 12);
        const number = (value) => value.toFixed(places).replace(/^-(?=[0.]*$)/, "").replace("-", "\u2212");
        const unit = this.layer.unit ? ` ${this.layer.unit}` : "";
        const cut = beyond ? `; ${beyond < 0.001 ? "<0.1" : (100 * beyond).toFixed(1)} % beyond the colours` : "";
        const thinned = this.data.columns < this.spec.nodes[0] || this.data.rows < this.spec.nodes[1]
          ? ` Shown: ${this.data.columns} \u00d7 ${this.data.rows} of ${this.spec.nodes[0]} \u00d7 ${this.spec.nodes[1]} nodes.` : "";
        this.summary.textContent = this.key === FLAGS ? `Each colour is a flag; hatched: no value.${thinned}`
          : count === 0 ? `No value in view.${thinned}`
            : `In view: mean ${number(mean)}${unit}, RMS ${number(rms)}${unit}, from ${number(least)} to `
              + `${number(most)}${unit}${cut}.${thinned}`;
      }, 120);
    }

    // ---- pointer and keys ----

    listen() {
      const { root } = this.figure;
      const move = (event) => {
        const { left, top, within } = this.figure.placeOf(event);
        this.readout.setAttribute("aria-live", "off");
        if (this.dragged) {
          this.section = [this.dragged, this.figure.toData(left, top)];
          this.over();
          this.drawSectionSoon();
        } else if (within && event.buttons === 0 || event.pointerType === "touch") {
          this.show(this.data.nodeAt(...this.figure.toData(left, top)), event.pointerType === "mouse" ? [left, top] : null);
        }
      };
      const down = (event) => {
        const { left, top, within } = this.figure.placeOf(event);
        if (!within || !(this.drawsSection || event.shiftKey)) return;
        root.focus({ preventScroll: true });
        this.dragged = this.figure.toData(left, top);
        root.setPointerCapture(event.pointerId);
        event.stopPropagation(); // the library would move the map
      };
      const up = (event) => {
        if (!this.dragged) {
          if (event.pointerType === "touch") move(event);
          return;
        }
        const { left, top } = this.figure.placeOf(event);
        const end = this.figure.toData(left, top);
        const [a, b] = [this.figure.toPixel(...this.dragged), [left, top]];
        this.section = Math.hypot(a[0] - b[0], a[1] - b[1]) > 4 ? [this.dragged, end] : null;
        this.dragged = null;
        this.sectioning(false);
        this.over();
        this.drawSection();
      };
      root.addEventListener("pointerdown", down, { capture: true });
      root.addEventListener("touchstart", (event) => { if (this.drawsSection) event.stopPropagation(); }, { capture: true, passive: true });
      root.addEventListener("pointermove", move);
      root.addEventListener("pointerup", up);
      root.addEventListener("pointercancel", () => { this.dragged = null; });
      root.addEventListener("keydown", (event) => this.key_(event));
    }

    // Shows the values of a node; tip: where the tip stands, none for the keyboard.
    show([column, row], tip = null) {
      const node = this.data.node(column, row);
      if (node < 0) {
        this.figure.hideTip();
        return;
      }
      this.pointer = [column, row];
      const { layer } = this;
      const reason = this.spec.reasons[this.data.codes[node]];
      const value = this.data.values[node];
      const sigma = this.data.sigma && this.data.sigma[node] * layer.factor;
      const { number } = heliogauge;
      const place = `${this.names[0]} ${number(this.spec.x[column])} ${this.unit}, ${this.names[1]} ${number(this.spec.y[row])} ${this.unit}`;
      const what = Number.isFinite(value) ? heliogauge.withSigma(value, sigma, layer.unit) : "no value";
      const why = this.data.aperture[node] ? reason.words.join(", ") : "outside the mirror";
      const part = this.data.partAt(node);
      const mark = this.wordsAt(...(tip || this.figure.toPixel(this.spec.x[column], this.spec.y[row])));
      const more = [part, mark].filter(Boolean);
      this.readout.replaceChildren(
        heliogauge.element("span", {}, place), ...more.map((words) => heliogauge.element("strong", {}, words)),
        heliogauge.element("strong", {}, `${layer.name}: ${what}`), heliogauge.element("span", {}, why || "no flag"),
      );
      if (tip) this.figure.showTip(...tip, ...more, what, ...(why ? [why] : []), place);
      this.over();
    }

    key_(event) {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const { key } = event;
      const done = this.moved(event) || this.chosen(key.toLowerCase());
      if (done) event.preventDefault();
    }

    moved({ key, shiftKey }) {
      const up = this.spec.y_down ? -1 : 1;
      const steps = { ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowUp: [0, up], ArrowDown: [0, -up] };
      if (!steps[key]) return false;
      const by = shiftKey ? 10 : 1;
      const [column, row] = this.pointer || this.middle();
      const next = this.pointer
        ? [Math.min(Math.max(column + by * steps[key][0], 0), this.data.columns - 1), Math.min(Math.max(row + by * steps[key][1], 0), this.data.rows - 1)]
        : [column, row];
      this.readout.setAttribute("aria-live", "polite");
      this.figure.hideTip();
      this.figure.follow(this.spec.x[next[0]], this.spec.y[next[1]]);
      this.show(next);
      return true;
    }

    middle() {
      const { x, y } = this.figure.seen();
      const at = this.data.nodeAt((x[0] + x[1]) / 2, (y[0] + y[1]) / 2);
      return [Math.min(Math.max(at[0], 0), this.data.columns - 1), Math.min(Math.max(at[1], 0), this.data.rows - 1)];
    }

    chosen(key) {
      const [column, row] = this.pointer || this.middle();
      const [x, y] = [this.spec.x[column], this.spec.y[row]];
      const zoom = (factor) => this.figure.zoomBy(factor, ...this.figure.toPixel(x, y));
      const cut = (section) => {
        this.section = section;
        this.over();
        this.drawSection();
      };
      const actions = {
        "+": () => zoom(1.5), "=": () => zoom(1.5), "-": () => zoom(1 / 1.5), 0: () => this.figure.reset(),
        f: () => this.data.flags.length && this.choose(this.key === FLAGS ? this.layer.key : FLAGS),
        r: () => this.nextRemoval(),
        h: () => cut([[this.data.ends.x[0], y], [this.data.ends.x[1], y]]),
        v: () => cut([[x, this.data.ends.y[0]], [x, this.data.ends.y[1]]]),
        s: () => {
          if (this.begun) cut([this.begun, [x, y]]);
          this.begun = this.begun ? null : [x, y];
          this.readout.append(this.begun ? " Section begins here." : "");
        },
        escape: () => { this.begun = null; this.sectioning(false); cut(null); },
      };
      if (/^[1-9]$/.test(key) && this.spec.layers[key - 1]) this.choose(this.spec.layers[key - 1].key);
      else if (actions[key]) actions[key]();
      else return false;
      return true;
    }

    nextRemoval() {
      const words = [...this.removalSelect.options].map((one) => one.value);
      if (words.length > 1) this.remove(words[(words.indexOf(this.data.removal) + 1) % words.length]);
    }

    // ---- sections ----

    sectioning(on) {
      this.drawsSection = on;
      this.sectionButton.setAttribute("aria-pressed", String(on));
      this.figure.root.classList.toggle("sectioning", on);
    }

    drawSectionSoon() {
      if (this.drawing) return;
      this.drawing = requestAnimationFrame(() => { this.drawing = 0; this.drawSection(); });
    }

    async drawSection() {
      if (!this.section) {
        this.sectionChart = null;
        this.sectionPlace.replaceChildren();
        return;
      }
      const { layer } = this;
      const found = this.data.sectionValues(this.section);
      this.sectionNodes = found.nodes;
      const point = ([x, y]) => `(${heliogauge.number(x, 3)}, ${heliogauge.number(y, 3)})`;
      const title = `${layer.name} from ${point(this.section[0])} to ${point(this.section[1])} ${this.unit}`;
      const series = [{ name: layer.name, x: found.x, y: found.y, sigma: this.data.sigma ? found.sigma : null, color: "#1b6ca8", mark: "line", size: 1.5 }];
      const unit = layer.unit ? ` [${layer.unit}]` : "";
      const content = { name: title, x_label: `along the section [${this.unit}]`, y_label: `${layer.name}${unit}`, series };
      if (this.sectionChart) {
        this.sectionTitle.textContent = title;
        (await this.sectionChart).show(content);
        return;
      }
      this.sectionTitle = heliogauge.element("span", {}, title);
      const band = this.data.sigma ? "band: \u00b1 1 sigma" : "";
      const close = heliogauge.element("button", { type: "button", click: () => { this.section = null; this.over(); this.drawSection(); } }, "Close");
      const place = heliogauge.element("div");
      this.sectionPlace.replaceChildren(
        heliogauge.element("div", { class: "view-bar" }, heliogauge.element("strong", {}, this.sectionTitle), band, close), place);
      this.sectionChart = heliogauge.drawChart(place, content, (index) => {
        if (index === null) return;
        this.show(this.sectionNodes[index]);
      });
      await this.sectionChart;
    }
  }

  heliogauge.kind("map", async (place, spec) => {
    await new MapOfLayers(place, spec).begin();
  });
})();
