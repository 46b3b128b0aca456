"use strict";
// Maps: values with sigma and flags under the pointer, layers, colour range, sections, tilt and focus removed live.
(() => {
  // Those of the static figures: RdBu_r for signed values, viridis from low to high; both safe for the colour-blind.
  const DIVERGING = ["#053061", "#2166ac", "#4393c3", "#92c5de", "#d1e5f0", "#f7f7f7", "#fddbc7", "#f4a582", "#d6604d",
    "#b2182b", "#67001f"];
  const SEQUENTIAL = ["#440154", "#471365", "#482475", "#463480", "#414487", "#3b528b", "#355f8d", "#2f6c8e", "#2a788e",
    "#25848e", "#21918c", "#1e9c89", "#22a884", "#2fb47c", "#44bf70", "#5ec962", "#7ad151", "#9bd93c", "#bddf26", "#dfe318",
    "#fde725"];
  // Okabe and Ito: told apart by the colour-blind.
  const FLAG_COLORS = ["#e69f00", "#56b4e9", "#009e73", "#f0e442", "#d55e00", "#cc79a7", "#0072b2", "#7f6b5d", "#b3b3ff",
    "#882255"];
  const STEPS = [1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10];
  const SHADES = 512;
  const FLAGS = "flags";
  // A tall mirror fills at most this share of the screen.
  const MOST_HEIGHT = 0.56;
  // Percentiles come from at most this many values.
  const SAMPLES = 60000;
  const REMOVAL_NAMES = { nothing: "nothing", tilt: "tilt", focus: "tilt and focus", quadratic: "tilt, focus, twist" };
  const KEYS = "Pointer: value, sigma and flags. Drag moves; the wheel zooms once the map was clicked (or with Ctrl), two "
    + "fingers always; double click shows all. Section: press the button, or hold Shift, and drag a line. Keys: arrows move "
    + "the pointer by a node (Shift: by ten), + and \u2212 zoom about it, 0 shows all, 1 to 9 choose the layer, F shows the "
    + "flags, R removes the next of tilt, focus and quadratic, H and V cut a section along x and along y, S begins and ends "
    + "a section at the pointer, Escape removes it.";

  const channels = (color) => [1, 3, 5].map((at) => parseInt(color.slice(at, at + 2), 16));
  const packed = ([red, green, blue]) => (0xff000000 | (Math.round(blue) << 16) | (Math.round(green) << 8) | Math.round(red)) >>> 0;

  function shade(stops, share) {
    const place = Math.min(Math.max(share, 0), 1) * (stops.length - 1);
    const low = Math.min(Math.floor(place), stops.length - 2);
    const [from, to] = [channels(stops[low]), channels(stops[low + 1])];
    return from.map((value, at) => value + (to[at] - value) * (place - low));
  }

  // Colour of a value; signed values have white at zero, also where the range is not symmetric.
  function shareOf(value, low, high, diverging) {
    if (!diverging) return (value - low) / (high - low);
    if (low >= 0) return 0.5 + 0.5 * (value - low) / (high - low);
    if (high <= 0) return 0.5 - 0.5 * (high - value) / (high - low);
    return value < 0 ? 0.5 - 0.5 * value / low : 0.5 + 0.5 * value / high;
  }

  function niceCeiling(value) {
    if (!Number.isFinite(value) || value <= 0) return 1;
    const power = 10 ** Math.floor(Math.log10(value));
    return Number((STEPS.find((step) => step >= value / power * (1 - 1e-9)) * power).toPrecision(6));
  }

  // Sorted values of an array at most; NaN left out.
  function sample(values, change = (value) => value) {
    const stride = Math.max(Math.ceil(values.length / SAMPLES), 1);
    const kept = new Float64Array(Math.ceil(values.length / stride));
    let count = 0;
    for (let index = 0; index < values.length; index += stride) {
      const value = change(values[index]);
      if (Number.isFinite(value)) kept[count++] = value;
    }
    return kept.subarray(0, count).sort();
  }

  const percentile = (sorted, share) => sorted[Math.min(Math.round(share * (sorted.length - 1)), sorted.length - 1)];
  // A number for an input: no more digits than are seen.
  const rounded = (value) => Number(value.toPrecision(4));

  class MapOfLayers {
    constructor(place, spec) {
      Object.assign(this, { place, spec, kept: new Map(), mode: "figure", removal: "nothing" });
      this.columns = spec.x.length;
      this.rows = spec.y.length;
      this.stepX = this.columns > 1 ? (spec.x[this.columns - 1] - spec.x[0]) / (this.columns - 1) : 1;
      this.stepY = this.rows > 1 ? (spec.y[this.rows - 1] - spec.y[0]) / (this.rows - 1) : 1;
      this.unit = spec.axis_unit;
      this.ends = { x: [spec.x[0] - this.stepX / 2, spec.x[this.columns - 1] + this.stepX / 2],
        y: [spec.y[0] - this.stepY / 2, spec.y[this.rows - 1] + this.stepY / 2] };
      this.removals = spec.removals.filter((one) => one.parts.length);
      this.pixels = [document.createElement("canvas"), document.createElement("canvas")];
      this.marked = new Set(); // bits that are painted on other layers
      this.unmarked = new Set(); // bits that are not painted on the layer of flags
    }

    async begin() {
      const { spec } = this;
      [this.codes, this.aperture] = await Promise.all([heliogauge.codes(spec.flags), heliogauge.codes(spec.aperture)]);
      this.flags = this.countFlags();
      this.buildControls();
      const orientation = spec.y_down ? "y down" : "seen from the front, y up";
      this.figure = await heliogauge.figure(this.body, `Map: ${spec.name}, x to the right, ${orientation}. Arrow keys read values.`, KEYS);
      this.figure.leastSpan = Math.min(100 * 8 / Math.max(this.columns, this.rows), 100);
      this.readout = heliogauge.element("output", { class: "view-readout", "aria-live": "off" }, "Move the pointer over the map.");
      this.summary = heliogauge.element("p", { class: "view-note" });
      this.figure.root.after(this.readout, this.summary);
      this.figure.onResize = () => this.draw();
      this.figure.onZoom = () => this.zoomed();
      this.listen();
      heliogauge.onTheme(() => { this.paintLegend(); this.draw(); });
      await this.choose(spec.layers[0].key);
    }

    // ---- numbers ----

    array(place) {
      if (!this.kept.has(place)) this.kept.set(place, heliogauge.numbers(this.spec.arrays[place]));
      return this.kept.get(place);
    }

    // Values of a layer in its printed unit, what is to be removed taken out.
    async valuesOf(layer) {
      const set = this.removals.find((one) => [one.x, one.y, one.magnitude].includes(layer.key));
      const part = set && this.removal !== "nothing" ? set.parts.find((one) => one.removal === this.removal) : null;
      const stored = await this.array(layer.values.place);
      const values = new Float32Array(stored.length);
      if (!part) {
        for (let index = 0; index < values.length; index++) values[index] = stored[index] * layer.factor;
        return values;
      }
      const [alongX, alongY] = await Promise.all([set.x, set.y].map((key, axis) => this.withoutPart(set, part, key, axis)));
      if (layer.key === set.x || layer.key === set.y) {
        const left = layer.key === set.x ? alongX : alongY;
        for (let index = 0; index < values.length; index++) values[index] = left[index] * layer.factor;
      } else {
        for (let index = 0; index < values.length; index++) values[index] = Math.hypot(alongX[index], alongY[index]) * layer.factor;
      }
      return values;
    }

    async withoutPart(set, part, key, axis) {
      const stored = await this.array(this.spec.layers.find((one) => one.key === key).values.place);
      const design = await this.array(set.design[axis].place);
      const [one, alongX, alongY, alongDesign] = part.terms[axis];
      const left = new Float64Array(stored.length);
      for (let row = 0, index = 0; row < this.rows; row++) {
        const start = one + alongY * (this.spec.y[row] - set.middle[1]);
        for (let column = 0; column < this.columns; column++, index++) {
          left[index] = stored[index] - start - alongX * (this.spec.x[column] - set.middle[0])
            - alongDesign * (design[index] - set.mean[axis]);
        }
      }
      return left;
    }

    countFlags() {
      const counts = new Map();
      const perCode = new Uint32Array(256);
      let nodes = 0;
      for (let index = 0; index < this.codes.length; index++) {
        if (this.aperture[index]) {
          perCode[this.codes[index]]++;
          nodes++;
        }
      }
      this.spec.reasons.forEach((reason, code) => {
        for (const word of perCode[code] ? reason.words : []) counts.set(word, (counts.get(word) || 0) + perCode[code]);
      });
      const found = [...counts].sort((one, other) => other[1] - one[1]);
      return found.map(([word, count], at) => ({ word, count, share: count / nodes, color: FLAG_COLORS[at % FLAG_COLORS.length] }));
    }

    node(column, row) {
      return column >= 0 && column < this.columns && row >= 0 && row < this.rows ? row * this.columns + column : -1;
    }

    nodeAt(x, y) {
      return [Math.round((x - this.spec.x[0]) / this.stepX), Math.round((y - this.spec.y[0]) / this.stepY)];
    }

    // ---- controls ----

    buildControls() {
      const { spec } = this;
      const make = heliogauge.element;
      const layers = [...spec.layers.map((one) => [one.key, one.name]), ...(this.flags.length ? [[FLAGS, "Flags"]] : [])];
      const option = ([value, name]) => make("option", { value }, name);
      this.layerSelect = make("select", { "aria-label": "Layer", change: () => this.choose(this.layerSelect.value) }, ...layers.map(option));
      const words = [...new Set(this.removals.flatMap((one) => one.parts.map((part) => part.removal)))];
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
      const beside = this.ends.x[1] - this.ends.x[0] < 1.35 * (this.ends.y[1] - this.ends.y[0]);
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
      const all = this.flags.map((one) => one.word);
      return new Set(all.filter((word) => this.key === FLAGS ? !this.unmarked.has(word) : this.marked.has(word)));
    }

    paintLegend() {
      const share = (one) => one.share >= 0.001 ? `${(100 * one.share).toFixed(1)} %` : `${one.count}`;
      const painted = this.painted;
      const entries = this.flags.map((one) => ({ name: `${one.word}: ${share(one)}`, color: one.color, on: painted.has(one.word),
        note: `${one.count} nodes of the mirror` }));
      const legend = heliogauge.legend(entries, (index, on) => {
        const set = this.key === FLAGS ? this.unmarked : this.marked;
        if (on === (this.key === FLAGS)) set.delete(this.flags[index].word);
        else set.add(this.flags[index].word);
        this.draw();
      }, "Flags painted on the map");
      const hatched = heliogauge.element("span", { class: "view-swatch view-hatched" });
      if (this.flags.length) legend.prepend("Paint by flag:");
      if (this.hasGaps) legend.prepend(heliogauge.element("span", {}, hatched, "no value there."));
      this.legendPlace.replaceChildren(legend);
    }

    showNumbers() {
      const texts = this.removals.flatMap((set) => {
        const part = set.parts.find((one) => one.removal === this.removal);
        if (!part) return [];
        const numbers = part.numbers.map(([name, text]) => `${name} ${text}`).join("   ");
        return [`${set.name ? `${set.name}: ` : ""}${numbers}`];
      });
      this.numbersLine.replaceChildren(...texts.map((text) => heliogauge.element("span", {}, text)));
      const part = this.removals[0]?.parts.find((one) => one.removal === this.removal);
      this.numbersLine.title = part ? `removed: ${part.removed}; deviation from: ${part.reference}` : "";
    }

    // ---- choices ----

    async choose(key) {
      this.key = key;
      this.layerSelect.value = key;
      const shown = key === FLAGS ? this.spec.layers[0] : this.spec.layers.find((one) => one.key === key);
      if (this.layer !== shown && this.mode === "hand") this.mode = "figure";
      this.layer = shown;
      await this.load();
      this.paintLegend();
    }

    async remove(removal) {
      this.removal = removal;
      this.removalSelect.value = removal;
      this.showNumbers();
      await this.load();
    }

    async load() {
      const { layer } = this;
      const turn = (this.turn = (this.turn || 0) + 1);
      const [values, sigma] = await Promise.all([this.valuesOf(layer), layer.sigma ? this.array(layer.sigma.place) : null]);
      if (turn !== this.turn) return; // the reader has chosen another meanwhile
      this.values = values;
      this.sigma = sigma;
      this.hasGaps = values.some((value, node) => value !== value && this.aperture[node]);
      this.unitText.textContent = layer.unit;
      this.colorsBar.hidden = this.key === FLAGS;
      await this.range();
      this.figure.hideTip();
      this.draw();
      if (this.pointer) this.show(this.pointer);
      if (this.section) await this.drawSection();
    }

    // Sets where the colours begin and end.
    async range() {
      const { layer, mode } = this;
      this.modeSelect.value = mode;
      if (mode === "hand") return;
      const set = this.removal === "nothing" ? null : this.removals.find((one) => [one.x, one.y, one.magnitude].includes(layer.key));
      if (mode === "figure" && !set) {
        this.low = layer.low;
        this.high = layer.high;
      } else {
        const share = mode === "figure" ? 0.99 : Number(mode);
        const nice = mode === "figure" ? niceCeiling : (value) => value || 1;
        if (layer.diverging) {
          let limit = percentile(sample(this.values, Math.abs), share);
          if (mode === "figure" && set) {
            // One range for both components, so that they compare.
            const other = this.spec.layers.find((one) => one.key === (layer.key === set.x ? set.y : set.x));
            limit = Math.max(limit, percentile(sample(await this.valuesOf(other), Math.abs), share));
          }
          this.high = nice(limit);
          this.low = -this.high;
        } else {
          const sorted = sample(this.values);
          const begins = layer.low === 0 && (sorted[0] ?? 0) >= 0;
          this.low = begins ? 0 : percentile(sorted, (1 - share) / 2);
          this.high = begins ? nice(percentile(sorted, share)) : percentile(sorted, (1 + share) / 2);
        }
      }
      if (!(this.high > this.low)) [this.low, this.high] = Number.isFinite(this.low) ? [this.low, this.low + 1] : [0, 1];
      this.lowInput.value = rounded(this.low);
      this.highInput.value = rounded(this.high);
    }

    async chooseMode(mode) {
      this.mode = mode;
      await this.range();
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
      const right = narrow ? 66 : 86;
      const most = { width: width - left - right, height: Math.max(MOST_HEIGHT * innerHeight, 260) };
      const size = { x: this.ends.x[1] - this.ends.x[0], y: this.ends.y[1] - this.ends.y[0] };
      const scale = Math.min(most.width / size.x, most.height / size.y); // pixels for each metre
      const box = { left, top: 8, width: Math.max(size.x * scale, 110), height: Math.max(size.y * scale, 110) };
      // Axes of a long trough leave room beside it rather than squeeze their labels.
      const around = ([low, high], pixels) => {
        const spare = (pixels / scale - (high - low)) / 2;
        return [low - spare, high + spare];
      };
      return { box, x: around(this.ends.x, box.width), y: around(this.ends.y, box.height), narrow };
    }

    draw() {
      if (!this.values || !this.figure.root.clientWidth) return;
      const { box, x, y, narrow } = this.layout();
      this.shades = this.shadesOf();
      const color = heliogauge.colors();
      const root = this.figure.root;
      root.style.height = `${box.height + 54}px`;
      this.figure.chart.resize();
      const labels = { formatter: heliogauge.tick };
      const option = this.figure.axes(box, x, y, {
        xName: `x [${this.unit}]${this.spec.y_down ? "" : narrow ? "  from the front" : "   seen from the front"}`, yName: `y [${this.unit}]`, yDown: this.spec.y_down,
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
        ...(even ? { interval } : {}), nameGap: narrow ? 34 : 44, splitLine: { show: false }, axisLine: { show: false },
        axisLabel: { color: color.ink, formatter: heliogauge.tick, showMinLabel: even, showMaxLabel: even } }));
      const custom = (axis, renderItem) => ({ type: "custom", xAxisIndex: axis, yAxisIndex: axis, data: [[0, 0]], silent: true, clip: true, renderItem });
      option.series = [custom(0, () => this.picture()), ...(bar ? [custom(1, (_, api) => this.colorBar(api))] : [])];
      this.figure.chart.setOption(option, { replaceMerge: ["series"] });
      this.over();
      this.summarise();
    }

    shadesOf() {
      const stops = this.layer.diverging ? DIVERGING : SEQUENTIAL;
      const shades = new Uint32Array(SHADES);
      for (let index = 0; index < SHADES; index++) {
        const value = this.low + (index + 0.5) / SHADES * (this.high - this.low);
        shades[index] = packed(shade(stops, shareOf(value, this.low, this.high, this.layer.diverging)));
      }
      return shades;
    }

    colorBar(api) {
      const canvas = document.createElement("canvas");
      [canvas.width, canvas.height] = [1, SHADES];
      const image = new ImageData(1, SHADES);
      new Uint32Array(image.data.buffer).set(this.shades.slice().reverse());
      canvas.getContext("2d").putImageData(image, 0, 0);
      const [left, top] = api.coord([0, this.high]);
      const [right, bottom] = api.coord([1, this.low]);
      return { type: "image", style: { image: canvas, x: left, y: top, width: right - left, height: bottom - top } };
    }

    // What is seen of the map, one look-up for each pixel of the screen: as quick for a million nodes as for a thousand.
    picture() {
      const { box } = this.figure;
      const ratio = Math.min(devicePixelRatio || 1, 2);
      const [width, height] = [Math.max(Math.round(box.width * ratio), 1), Math.max(Math.round(box.height * ratio), 1)];
      // Two canvases by turns, so that the library sees a new picture each time.
      const canvas = this.pixels.reverse()[0];
      [canvas.width, canvas.height] = [width, height];
      const image = new ImageData(width, height);
      this.paint(new Uint32Array(image.data.buffer), width, height, ratio);
      canvas.getContext("2d").putImageData(image, 0, 0);
      return { type: "image", style: { image: canvas, x: box.left, y: box.top, width: box.width, height: box.height } };
    }

    paint(pixels, width, height, ratio) {
      const { values, codes, aperture, columns, shades, low } = this;
      const { x: [x0, x1], y: [y0, y1] } = this.figure.seen();
      const places = (count, first, last, origin, step, nodes) => Int32Array.from({ length: count }, (_, at) => {
        const node = Math.round((first + (at + 0.5) / count * (last - first) - origin) / step);
        return node >= 0 && node < nodes ? node : -1;
      });
      const across = places(width, x0, x1, this.spec.x[0], this.stepX, columns);
      const top = this.spec.y_down ? [y0, y1] : [y1, y0];
      const down = places(height, ...top, this.spec.y[0], this.stepY, this.rows);
      const color = heliogauge.colors();
      const [missing, hatch, edge, plain] = [color.missing, color.hatch, color.faint, color.dark ? "#232b33" : "#eef1f4"]
        .map((one) => packed(channels(one)));
      const period = Math.round(8 * ratio);
      const stroke = Math.max(Math.round(1.4 * ratio), 1);
      const scale = SHADES / (this.high - this.low);
      const ofCode = this.colorOfCode();
      const flagsOnly = this.key === FLAGS;
      for (let y = 0, pixel = 0; y < height; y++) {
        const start = down[y] < 0 ? -1 : down[y] * columns;
        const above = y > 0 && down[y - 1] >= 0 ? down[y - 1] * columns : -1;
        let before = false;
        for (let x = 0; x < width; x++, pixel++) {
          const column = across[x];
          const node = start < 0 || column < 0 ? -1 : start + column;
          const inside = node >= 0 && aperture[node] !== 0;
          const over = above >= 0 && column >= 0 && aperture[above + column] !== 0;
          if (inside !== before && x > 0 || inside !== over && y > 0) pixels[pixel] = edge;
          else if (inside) {
            const mark = ofCode[codes[node]];
            const value = values[node];
            if (mark) pixels[pixel] = mark;
            else if (value !== value) pixels[pixel] = (x + y) % period < stroke ? hatch : missing;
            else if (flagsOnly) pixels[pixel] = plain;
            else {
              const at = (value - low) * scale;
              pixels[pixel] = shades[at < 0 ? 0 : at >= SHADES ? SHADES - 1 : at | 0];
            }
          }
          before = inside;
        }
      }
    }

    // Colour of each combination of flags; zero where none of its flags is painted.
    colorOfCode() {
      const painted = this.painted;
      const colors = new Uint32Array(256);
      this.spec.reasons.forEach((reason, code) => {
        // The rarest flag shows: the common ones would hide it.
        const shown = this.flags.filter((one) => painted.has(one.word) && reason.words.includes(one.word)).pop();
        if (shown) colors[code] = packed(channels(shown.color));
      });
      return colors;
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
        const { x, y } = this.figure.seen();
        const [first, low] = this.nodeAt(x[0] + this.stepX / 2, y[0] + this.stepY / 2).map((at) => Math.max(at, 0));
        const [last, high] = this.nodeAt(x[1] - this.stepX / 2, y[1] - this.stepY / 2);
        let [count, sum, squares, least, most, beyond] = [0, 0, 0, Infinity, -Infinity, 0];
        for (let row = low; row <= Math.min(high, this.rows - 1); row++) {
          for (let column = first; column <= Math.min(last, this.columns - 1); column++) {
            const node = row * this.columns + column;
            const value = this.values[node];
            if (value !== value || !this.aperture[node]) continue;
            count++;
            sum += value;
            squares += value * value;
            if (value < least) least = value;
            if (value > most) most = value;
            if (value < this.low || value > this.high) beyond++;
          }
        }
        const rms = Math.sqrt(squares / count);
        // All with the decimals of the RMS: a mean of zero is zero.
        const places = Math.min(Math.max(2 - Math.floor(Math.log10(rms || 1)), 0), 12);
        const number = (value) => value.toFixed(places).replace(/^-(?=[0.]*$)/, "").replace("-", "\u2212");
        const unit = this.layer.unit ? ` ${this.layer.unit}` : "";
        const share = beyond / count;
        const cut = beyond ? `; ${share < 0.001 ? "<0.1" : (100 * share).toFixed(1)} % beyond the colours` : "";
        const thinned = this.columns < this.spec.nodes[0] || this.rows < this.spec.nodes[1]
          ? ` Shown: ${this.columns} \u00d7 ${this.rows} of ${this.spec.nodes[0]} \u00d7 ${this.spec.nodes[1]} nodes.` : "";
        this.summary.textContent = this.key === FLAGS ? `Each colour is a flag; hatched: no value.${thinned}`
          : count === 0 ? `No value in view.${thinned}`
            : `In view: mean ${number(sum / count)}${unit}, RMS ${number(rms)}${unit}, from ${number(least)} to `
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
          this.show(this.nodeAt(...this.figure.toData(left, top)), event.pointerType === "mouse" ? [left, top] : null);
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
      const node = this.node(column, row);
      if (node < 0) {
        this.figure.hideTip();
        return;
      }
      this.pointer = [column, row];
      const { layer } = this;
      const reason = this.spec.reasons[this.codes[node]];
      const value = this.values[node];
      const sigma = this.sigma && this.sigma[node] * layer.factor;
      const { number } = heliogauge;
      const place = `x ${number(this.spec.x[column])} ${this.unit}, y ${number(this.spec.y[row])} ${this.unit}`;
      const what = Number.isFinite(value) ? heliogauge.withSigma(value, sigma, layer.unit) : "no value";
      const why = this.aperture[node] ? reason.words.join(", ") : "outside the mirror";
      this.readout.replaceChildren(
        heliogauge.element("span", {}, place), heliogauge.element("strong", {}, `${layer.name}: ${what}`),
        heliogauge.element("span", {}, why || "no flag"),
      );
      if (tip) this.figure.showTip(...tip, what, ...(why ? [why] : []), place);
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
        ? [Math.min(Math.max(column + by * steps[key][0], 0), this.columns - 1), Math.min(Math.max(row + by * steps[key][1], 0), this.rows - 1)]
        : [column, row];
      this.readout.setAttribute("aria-live", "polite");
      this.figure.hideTip();
      this.figure.follow(this.spec.x[next[0]], this.spec.y[next[1]]);
      this.show(next);
      return true;
    }

    middle() {
      const { x, y } = this.figure.seen();
      const at = this.nodeAt((x[0] + x[1]) / 2, (y[0] + y[1]) / 2);
      return [Math.min(Math.max(at[0], 0), this.columns - 1), Math.min(Math.max(at[1], 0), this.rows - 1)];
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
        f: () => this.flags.length && this.choose(this.key === FLAGS ? this.layer.key : FLAGS),
        r: () => this.nextRemoval(),
        h: () => cut([[this.ends.x[0], y], [this.ends.x[1], y]]),
        v: () => cut([[x, this.ends.y[0]], [x, this.ends.y[1]]]),
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
      if (words.length > 1) this.remove(words[(words.indexOf(this.removal) + 1) % words.length]);
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

    // Values of the nodes nearest to the line, one for each step of the grid.
    sectionValues() {
      const [[x0, y0], [x1, y1]] = this.section;
      const length = Math.hypot(x1 - x0, y1 - y0);
      const count = Math.min(Math.max(Math.ceil(length / Math.min(this.stepX, this.stepY)), 2), 4000) + 1;
      const found = { x: new Float64Array(count), y: new Float64Array(count).fill(NaN), sigma: new Float64Array(count).fill(NaN), nodes: [] };
      for (let index = 0; index < count; index++) {
        const share = index / (count - 1);
        const place = this.nodeAt(x0 + share * (x1 - x0), y0 + share * (y1 - y0));
        const node = this.node(...place);
        found.x[index] = share * length;
        found.nodes.push(place);
        if (node < 0) continue;
        found.y[index] = this.values[node];
        if (this.sigma) found.sigma[index] = this.sigma[node] * this.layer.factor;
      }
      return found;
    }

    async drawSection() {
      if (!this.section) {
        this.sectionChart = null;
        this.sectionPlace.replaceChildren();
        return;
      }
      const { layer } = this;
      const found = this.sectionValues();
      this.sectionNodes = found.nodes;
      const point = ([x, y]) => `(${heliogauge.number(x, 3)}, ${heliogauge.number(y, 3)})`;
      const title = `${layer.name} from ${point(this.section[0])} to ${point(this.section[1])} ${this.unit}`;
      const series = [{ name: layer.name, x: found.x, y: found.y, sigma: this.sigma ? found.sigma : null, color: "#1b6ca8", mark: "line", size: 1.5 }];
      const unit = layer.unit ? ` [${layer.unit}]` : "";
      const content = { name: title, x_label: `along the section [${this.unit}]`, y_label: `${layer.name}${unit}`, series };
      if (this.sectionChart) {
        this.sectionTitle.textContent = title;
        (await this.sectionChart).show(content);
        return;
      }
      this.sectionTitle = heliogauge.element("span", {}, title);
      const band = this.sigma ? "band: \u00b1 1 sigma" : "";
      const close = heliogauge.element("button", { type: "button", click: () => { this.section = null; this.over(); this.drawSection(); } }, "Close");
      const place = heliogauge.element("div");
      this.sectionPlace.replaceChildren(
        heliogauge.element("div", { class: "view-bar" }, heliogauge.element("strong", {}, this.sectionTitle), band, close), place);
      this.sectionChart = heliogauge.drawChart(place, content, (index) => {
        if (index === null) return;
        this.pointer = this.sectionNodes[index];
        if (this.node(...this.pointer) >= 0) this.over();
        else this.pointer = null;
      });
      await this.sectionChart;
    }
  }

  heliogauge.kind("map", async (place, spec) => {
    await new MapOfLayers(place, spec).begin();
  });
})();
