"use strict";
// What a map holds, as numbers: layers with what is removed from them, flags, ranges, sections, what is in view.
(() => {
  // Okabe and Ito: told apart by the colour-blind.
  const FLAG_COLORS = ["#e69f00", "#56b4e9", "#009e73", "#f0e442", "#d55e00", "#cc79a7", "#0072b2", "#7f6b5d", "#b3b3ff",
    "#882255"];
  const STEPS = [1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10];
  // Percentiles come from at most this many values.
  const SAMPLES = 60000;

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

  class MapData {
    constructor(spec) {
      Object.assign(this, { spec, kept: new Map(), columns: spec.x.length, rows: spec.y.length, removal: "nothing" });
      this.removals = spec.removals.filter((one) => one.parts.length);
      this.stepX = this.columns > 1 ? (spec.x[this.columns - 1] - spec.x[0]) / (this.columns - 1) : 1;
      this.stepY = this.rows > 1 ? (spec.y[this.rows - 1] - spec.y[0]) / (this.rows - 1) : 1;
      this.ends = { x: [spec.x[0] - this.stepX / 2, spec.x[this.columns - 1] + this.stepX / 2],
        y: [spec.y[0] - this.stepY / 2, spec.y[this.rows - 1] + this.stepY / 2] };
      this.removals = spec.removals.filter((one) => one.parts.length);
    }

    async begin() {
      const { flags, aperture, regions } = this.spec;
      [this.codes, this.aperture, this.parts] = await Promise.all([heliogauge.codes(flags), heliogauge.codes(aperture),
        regions ? heliogauge.codes(regions.index) : null]);
      this.flags = this.countFlags();
      return this;
    }

    // Name of the part of the map that a node belongs to; empty where there is none.
    partAt(node) {
      return this.parts ? this.spec.regions.names[this.parts[node]] || "" : "";
    }

    array(place) {
      if (!this.kept.has(place)) this.kept.set(place, heliogauge.numbers(this.spec.arrays[place]));
      return this.kept.get(place);
    }

    // Makes a layer the one that is seen, without what is removed; false where another was asked for meanwhile.
    async take(layer) {
      const turn = (this.turn = (this.turn || 0) + 1);
      const [values, sigma] = await Promise.all([this.valuesOf(layer), layer.sigma ? this.array(layer.sigma.place) : null]);
      if (turn !== this.turn) return false;
      Object.assign(this, { layer, values, sigma });
      this.hasGaps = values.some((value, node) => value !== value && this.aperture[node]);
      return true;
    }

    setOf(layer) {
      return this.removals.find((one) => [one.x, one.y, one.magnitude].includes(layer.key));
    }

    // Values of a layer in its printed unit, what is to be removed taken out.
    async valuesOf(layer) {
      const set = this.setOf(layer);
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

    // Values of the nodes nearest to the line, one for each step of the grid.
    sectionValues([[x0, y0], [x1, y1]]) {
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

    // Where the colours begin and end: as in print ("figure"), or so that a share of the values lies between.
    async range(mode) {
      const { layer } = this;
      const set = this.removal === "nothing" ? null : this.setOf(layer);
      const found = mode === "figure" && !set ? [layer.low, layer.high] : await this.rangeOfValues(mode, set);
      if (found[1] > found[0]) return found;
      return Number.isFinite(found[0]) ? [found[0], found[0] + 1] : [0, 1];
    }

    async rangeOfValues(mode, set) {
      const { layer } = this;
      const share = mode === "figure" ? 0.99 : Number(mode);
      const nice = mode === "figure" ? niceCeiling : (value) => value || 1;
      if (layer.diverging) {
        let limit = percentile(sample(this.values, Math.abs), share);
        if (mode === "figure") {
          // One range for both components, so that they compare.
          const other = this.spec.layers.find((one) => one.key === (layer.key === set.x ? set.y : set.x));
          limit = Math.max(limit, percentile(sample(await this.valuesOf(other), Math.abs), share));
        }
        return [-nice(limit), nice(limit)];
      }
      const sorted = sample(this.values);
      if (layer.low === 0 && (sorted[0] ?? 0) >= 0) return [0, nice(percentile(sorted, share))];
      return [percentile(sorted, (1 - share) / 2), percentile(sorted, (1 + share) / 2)];
    }

    // Count, mean, RMS and ends of the values within a part of the map, and how many are beyond the colours.
    numbersWithin({ x, y }, [lowest, highest]) {
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
          if (value < lowest || value > highest) beyond++;
        }
      }
      return { count, mean: sum / count, rms: Math.sqrt(squares / count), least, most, beyond: beyond / count };
    }
  }

  heliogauge.mapData = (spec) => new MapData(spec).begin();
})();
