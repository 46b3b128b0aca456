"use strict";
// Photos with what was found in them: marks, residual vectors, lines. ECharts draws, zooms and moves (figure.js); a photo's
// marks of one kind are one path or one image, so that tens of thousands stay smooth.
(() => {
  const MOST_HEIGHT = 0.72; // of the window
  const REACH_PX = 12;
  const ARROW = "#ff9f1c";
  // Beyond these marks lie closer than they are wide.
  const MANY = 4000;
  const KEYS = "Pointer: the nearest mark. Drag moves; the wheel zooms once the photo was clicked (or with Ctrl), two fingers "
    + "always. Keys: left and right to the neighbouring photo, comma and full stop from mark to mark, r to the next refused "
    + "one, Shift and arrows move, + and \u2212 zoom, 0 shows all.";

  const minus = (text) => text.replace(/-/g, "\u2212");

  let shapesKnown = false;

  // Two shapes of our own for ECharts: many marks in one path, many strokes in one path; places already in pixels.
  function defineShapes(echarts) {
    if (shapesKnown) return;
    shapesKnown = true;
    const { extendShape, registerShape } = echarts.graphic;
    registerShape("heliogauge-marks", extendShape({
      shape: { places: [], radius: 5, refused: false },
      buildPath(path, { places, radius, refused }) {
        const arm = radius * 0.85;
        for (let index = 0; index < places.length; index += 2) {
          const x = places[index];
          const y = places[index + 1];
          if (refused) {
            path.moveTo(x - arm, y - arm);
            path.lineTo(x + arm, y + arm);
            path.moveTo(x - arm, y + arm);
            path.lineTo(x + arm, y - arm);
          } else {
            path.moveTo(x + radius, y);
            path.arc(x, y, radius, 0, 2 * Math.PI);
          }
        }
      },
    }));
    registerShape("heliogauge-strokes", extendShape({
      shape: { places: [], heads: 0 },
      buildPath(path, { places, heads }) {
        for (let index = 0; index < places.length; index += 4) {
          const [x, y, u, v] = [places[index], places[index + 1], places[index + 2], places[index + 3]];
          path.moveTo(x, y);
          path.lineTo(u, v);
          const length = Math.hypot(u - x, v - y);
          if (heads && length > 2 * heads) {
            const [a, b] = [(u - x) / length * heads, (v - y) / length * heads];
            path.moveTo(u - a - 0.5 * b, v - b + 0.5 * a);
            path.lineTo(u, v);
            path.lineTo(u - a + 0.5 * b, v - b - 0.5 * a);
          }
        }
      },
    }));
  }

  class Photos {
    constructor(place, spec) {
      this.place = place;
      this.spec = spec;
      this.index = -1;
      this.found = null;
      this.off = new Set();
      this.factor = 1;
    }

    async begin() {
      const { element } = heliogauge;
      const { photos } = this.spec;
      this.place.append(element("p", { class: "view-title" }, this.spec.name));
      this.list = element("select", { "aria-label": "Photo", change: () => this.choose(this.list.selectedIndex) },
        ...photos.map((photo) => element("option", {}, this.listed(photo))));
      const step = (words, by) => element("button", {
        type: "button", "aria-label": by < 0 ? "Previous photo" : "Next photo", click: () => this.step(by),
      }, words);
      this.bar = element("div", { class: "view-bar turn" });
      if (photos.length > 1) this.bar.append(step("\u2190", -1), this.list, step("\u2192", 1));
      this.place.append(this.bar);
      this.legendPlace = element("div");
      this.slider = element("input", {
        type: "range", min: "-2", max: "2", step: "0.01", value: "0", "aria-label": "Length of the residual vectors",
        input: () => { this.factor = 10 ** Number(this.slider.value); this.draw(); },
      });
      this.sliderWords = element("output", {});
      this.sliderBar = element("div", { class: "view-bar" },
        element("label", {}, "Residuals enlarged", this.slider), this.sliderWords);
      this.place.append(this.legendPlace, this.sliderBar);
      defineShapes(await heliogauge.library("echarts"));
      this.figure = await heliogauge.figure(this.place, `${this.spec.name}. Photos by left and right, marks by comma and full stop.`, KEYS);
      this.readout = element("output", { class: "view-readout", "aria-live": "off" });
      this.note = element("p", { class: "view-note" });
      this.figure.root.after(this.readout, this.note);
      this.figure.onResize = () => this.draw();
      this.figure.onZoom = () => this.point(null);
      this.figure.root.addEventListener("pointermove", (event) => this.pointer(event));
      this.figure.root.addEventListener("pointerleave", () => this.point(null));
      this.figure.root.addEventListener("keydown", (event) => this.key(event));
      heliogauge.onTheme(() => this.draw());
      await this.choose(0);
      return this;
    }

    listed(photo) {
      const counts = photo.marks.map((one) => `${one.xy.shape[1]} ${one.name}`).join(", ");
      return counts ? `${photo.name}: ${counts}` : photo.name;
    }

    async choose(index) {
      const asked = this.asked = this.spec.photos[index];
      const read = await this.read(asked);
      // The reader may have gone on meanwhile.
      if (this.asked !== asked) return;
      this.index = index;
      this.photo = read;
      this.list.selectedIndex = index;
      this.found = null;
      this.figure.zoom = { x: [0, 100], y: [0, 100] };
      this.figure.leastSpan = Math.min(100 * 16 / Math.max(...read.size), 100);
      this.each = new Map();
      this.layers();
      this.draw();
      this.readout.textContent = "";
      this.note.textContent = [`Photo ${index + 1} of ${this.spec.photos.length}`, read.note].filter(Boolean).join(". ");
    }

    step(by) {
      const { length } = this.spec.photos;
      return this.choose((this.index + by + length) % length);
    }

    async read(photo) {
      const halves = (all) => [all.subarray(0, all.length / 2), all.subarray(all.length / 2)];
      const [image, marks, lines] = await Promise.all([
        photo.image ? heliogauge.image(photo.image) : null,
        Promise.all(photo.marks.map(async (one) => {
          const [x, y] = halves(await heliogauge.numbers(one.xy));
          const [u, v] = one.residual ? halves(await heliogauge.numbers(one.residual)) : [null, null];
          return { ...one, x, y, u, v, texts: await heliogauge.lines(one.labels) };
        })),
        Promise.all(photo.lines.map(async (one) => {
          const [x, y] = halves(await heliogauge.numbers(one.xy));
          return { ...one, x, y };
        })),
      ]);
      return { ...photo, image, marks, lines };
    }

    // ---- layers ----

    layers() {
      const { marks, lines, image } = this.photo;
      const count = (one) => `${one.x.length} in this photo`;
      const entries = [
        ...(image ? [{ key: "image", name: "photo", color: "#888888" }] : []),
        ...marks.map((one) => ({ key: `mark ${one.name}`, name: `${one.refused ? "\u00d7" : "\u25cb"} ${one.name}`, color: one.color, note: count(one) })),
        ...(marks.some((one) => one.u) ? [{ key: "residuals", name: "residuals", color: ARROW, note: "measured minus predicted" }] : []),
        ...lines.map((one) => ({ key: `line ${one.name}`, name: one.name, color: one.color })),
      ].map((one) => ({ ...one, on: !this.off.has(one.key) }));
      this.legendPlace.replaceChildren(heliogauge.legend(entries, (index, on) => {
        if (on) this.off.delete(entries[index].key);
        else this.off.add(entries[index].key);
        this.draw();
      }, "Layers"));
      this.sliderBar.hidden = !marks.some((one) => one.u);
    }

    shown() {
      return this.photo.marks.filter((one) => !this.off.has(`mark ${one.name}`));
    }

    get scale() {
      return this.photo.scale * this.factor;
    }

    // ---- drawing ----

    draw() {
      const { figure, photo } = this;
      const width = figure.root.clientWidth;
      if (!photo || !width) return;
      const narrow = width < 480;
      const left = narrow ? 44 : 58;
      const most = { width: width - left - 14, height: Math.max(MOST_HEIGHT * innerHeight, 240) };
      const [columns, rows] = photo.size;
      const scale = Math.min(most.width / columns, most.height / rows);
      const box = { left, top: 8, width: columns * scale, height: rows * scale };
      const height = `${box.height + 50}px`;
      if (figure.root.style.height !== height) {
        figure.root.style.height = height;
        figure.chart.resize();
      }
      const color = heliogauge.colors();
      const labels = { color: color.ink, hideOverlap: true, showMinLabel: false, showMaxLabel: false, formatter: (value) => heliogauge.number(value, 5).replace(/\.0+$/, "") };
      const option = figure.axes(box, [-0.5, columns - 0.5], [-0.5, rows - 0.5], {
        xName: "column [px]", yName: "row [px]", yDown: true,
        xAxis: { splitLine: { show: false }, axisLabel: labels, nameGap: 26, splitNumber: narrow ? 4 : 8 },
        yAxis: { splitLine: { show: false }, axisLabel: labels, nameGap: narrow ? 34 : 44 },
      });
      const series = (z, renderItem) => ({ type: "custom", data: [[0, 0]], z, silent: true, clip: true, renderItem });
      option.series = [];
      if (photo.image && !this.off.has("image")) option.series.push(series(1, () => this.picture()));
      for (const one of photo.lines) {
        if (!this.off.has(`line ${one.name}`)) option.series.push(series(2, () => this.lines(one)));
      }
      for (const one of this.shown()) {
        if (one.u && !this.off.has("residuals")) option.series.push(series(3, () => this.arrows(one)));
        option.series.push(series(4, () => this.marks(one)));
      }
      // A series without anything keeps the axes.
      if (!option.series.length) option.series.push({ type: "scatter", data: [] });
      figure.chart.setOption(option, { replaceMerge: ["series"] });
      this.over();
    }

    picture() {
      const [columns, rows] = this.photo.size;
      const [left, top] = this.figure.toPixel(-0.5, -0.5);
      const [right, bottom] = this.figure.toPixel(columns - 0.5, rows - 0.5);
      return { type: "image", style: { image: this.photo.image, x: left, y: top, width: right - left, height: bottom - top } };
    }

    // Places in the figure [px] as x = a column + b, y = c row + d.
    affine() {
      const [b, d] = this.figure.toPixel(0, 0);
      const [right, below] = this.figure.toPixel(1, 1);
      return [right - b, b, below - d, d];
    }

    // The marks that are seen: their numbers.
    seen(one, spare) {
      const [a, b, c, d] = this.affine();
      const { left, top, width, height } = this.figure.box;
      const found = [];
      for (let index = 0; index < one.x.length; index++) {
        const x = a * one.x[index] + b;
        const y = c * one.y[index] + d;
        if (x > left - spare && x < left + width + spare && y > top - spare && y < top + height + spare) found.push(index);
      }
      return found;
    }

    marks(one) {
      const [a, b, c, d] = this.affine();
      const seen = this.seen(one, 8);
      const places = new Float32Array(2 * seen.length);
      seen.forEach((index, at) => {
        places[2 * at] = a * one.x[index] + b;
        places[2 * at + 1] = c * one.y[index] + d;
      });
      if (seen.length > MANY) return this.dots(places, one.color);
      return {
        type: "heliogauge-marks", shape: { places, radius: 5, refused: one.refused },
        style: { fill: "none", stroke: one.color, lineWidth: 1.6 },
      };
    }

    // Marks that lie closer than they are wide, as dots in an image: 90,000 paths take a second to draw, dots 5 ms.
    dots(places, color) {
      const { box } = this.figure;
      const ratio = Math.min(devicePixelRatio || 1, 2);
      const [width, height] = [Math.round(box.width * ratio), Math.round(box.height * ratio)];
      const canvas = heliogauge.element("canvas", { width, height });
      const drawing = canvas.getContext("2d");
      const pixels = drawing.createImageData(width, height);
      const whole = new Uint32Array(pixels.data.buffer);
      // Bytes lie as red, green, blue, opacity from the lowest upwards.
      const [red, green, blue] = [1, 3, 5].map((at) => parseInt(color.slice(at, at + 2), 16));
      const tint = (255 << 24 | blue << 16 | green << 8 | red) >>> 0;
      const size = Math.round(2 * ratio);
      for (let index = 0; index < places.length; index += 2) {
        const column = Math.round((places[index] - box.left) * ratio - size / 2);
        const row = Math.round((places[index + 1] - box.top) * ratio - size / 2);
        for (let y = Math.max(row, 0); y < Math.min(row + size, height); y++) {
          for (let x = Math.max(column, 0); x < Math.min(column + size, width); x++) whole[y * width + x] = tint;
        }
      }
      drawing.putImageData(pixels, 0, 0);
      return { type: "image", style: { image: canvas, x: box.left, y: box.top, width: box.width, height: box.height } };
    }

    // The residuals of what is seen; of very many every n-th, for more would hide each other.
    arrows(one) {
      const [a, b, c, d] = this.affine();
      const { scale } = this;
      // An arrow that begins beside what is seen may reach into it.
      const seen = this.seen(one, 200).filter((index) => Number.isFinite(one.u[index]));
      const each = Math.ceil(seen.length / MANY);
      const kept = each > 1 ? seen.filter((index) => index % each === 0) : seen;
      const places = new Float32Array(4 * kept.length);
      kept.forEach((index, at) => {
        const x = a * one.x[index] + b;
        const y = c * one.y[index] + d;
        places.set([x, y, x + a * scale * one.u[index], y + c * scale * one.v[index]], 4 * at);
      });
      this.each.set(one.name, each);
      this.tellScale();
      return { type: "heliogauge-strokes", shape: { places, heads: 5 }, style: { fill: "none", stroke: ARROW, lineWidth: 1.6 } };
    }

    tellScale() {
      const each = Math.max(...this.each.values());
      const words = each > 1 ? `; 1 of ${each} is drawn, zoom in for all` : "";
      this.sliderWords.textContent = `${heliogauge.number(this.scale, 3)} times${words}`;
    }

    lines(one) {
      const [a, b, c, d] = this.affine();
      const places = [];
      let first = 0;
      for (const length of one.lengths) {
        for (let index = first; index < first + length - 1; index++) {
          places.push(a * one.x[index] + b, c * one.y[index] + d, a * one.x[index + 1] + b, c * one.y[index + 1] + d);
        }
        first += length;
      }
      return {
        type: "heliogauge-strokes", shape: { places: Float32Array.from(places), heads: 0 },
        style: { fill: "none", stroke: one.color, lineWidth: 1.6 },
      };
    }

    // What lies above the photo: the mark that is named, and how long a residual is drawn.
    over() {
      const { figure, found } = this;
      const color = heliogauge.colors();
      const shapes = [];
      if (!this.sliderBar.hidden && !this.off.has("residuals")) {
        const perPixel = this.affine()[0] * this.scale;
        const most = figure.box.width / 4 / perPixel;
        const power = 10 ** Math.floor(Math.log10(most));
        const length = [5, 2, 1].find((one) => one * power <= most) * power;
        const [left, top] = [figure.box.left + 12, figure.box.top + figure.box.height - 14];
        const bar = { x1: left, y1: top, x2: left + length * perPixel, y2: top };
        shapes.push(["line", { ...bar, stroke: "#000000", "stroke-width": 5, "stroke-opacity": 0.6 }]);
        shapes.push(["line", { ...bar, stroke: ARROW, "stroke-width": 2.5 }]);
        shapes.push(["text", {
          x: left, y: top - 7, fill: ARROW, "font-size": 12, stroke: "#000000", "stroke-width": 3, "stroke-opacity": 0.6,
          "paint-order": "stroke",
        }, `residual of ${heliogauge.number(length, 1)} px`]);
      }
      if (found) {
        const [left, top] = figure.toPixel(found.one.x[found.index], found.one.y[found.index]);
        const ring = { cx: left, cy: top, r: 9, fill: "none" };
        shapes.push(["circle", { ...ring, stroke: color.paper, "stroke-width": 4 }], ["circle", { ...ring, stroke: color.ink, "stroke-width": 2 }]);
      }
      figure.drawOver(shapes);
    }

    // ---- the mark that is named ----

    pointer(event) {
      if (event.buttons) return;
      const { left, top, within } = this.figure.placeOf(event);
      if (!within || !this.photo) {
        this.point(null);
        return;
      }
      this.point(this.nearest(left, top));
      if (!this.found) {
        const [x, y] = this.figure.toData(left, top);
        this.readout.textContent = minus(`column ${x.toFixed(1)}, row ${y.toFixed(1)} px`);
      }
    }

    nearest(left, top) {
      const [a, b, c, d] = this.affine();
      let best = null;
      let least = REACH_PX ** 2;
      for (const one of this.shown()) {
        for (let index = 0; index < one.x.length; index++) {
          const across = a * one.x[index] + b - left;
          const down = c * one.y[index] + d - top;
          const away = across * across + down * down;
          if (away < least) {
            least = away;
            best = { one, index };
          }
        }
      }
      return best;
    }

    words({ one, index }) {
      const text = one.texts[index];
      const words = [text ? `${one.name}: ${text}` : one.name, minus(`column ${one.x[index].toFixed(2)}, row ${one.y[index].toFixed(2)} px`)];
      if (one.u && Number.isFinite(one.u[index])) {
        const [u, v] = [one.u[index], one.v[index]];
        words.push(minus(`residual ${u.toFixed(3)}, ${v.toFixed(3)} px, together ${Math.hypot(u, v).toFixed(3)} px`));
      }
      return words;
    }

    point(found, aloud = false) {
      this.found = found;
      this.readout.setAttribute("aria-live", aloud ? "polite" : "off");
      if (found) {
        const words = this.words(found);
        this.figure.showTip(...this.figure.toPixel(found.one.x[found.index], found.one.y[found.index]), ...words);
        this.readout.textContent = words.join("; ");
      } else {
        this.figure.hideTip();
        this.readout.textContent = "";
      }
      if (this.photo) this.over();
    }

    // Goes to the next mark of what is shown, from the last one to the first.
    next(by, wanted = () => true) {
      const kinds = this.shown().filter((one) => wanted(one) && one.x.length);
      if (!kinds.length) return;
      let kind = this.found ? kinds.indexOf(this.found.one) : -1;
      let index = kind < 0 ? -1 : this.found.index + by;
      if (kind < 0 || index < 0 || index >= kinds[kind].x.length) {
        kind = kind < 0 ? (by > 0 ? 0 : kinds.length - 1) : (kind + by + kinds.length) % kinds.length;
        index = by > 0 ? 0 : kinds[kind].x.length - 1;
      }
      const one = kinds[kind];
      this.figure.follow(one.x[index], one.y[index]);
      this.point({ one, index }, true);
    }

    key(event) {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const { figure } = this;
      const middle = this.found
        ? figure.toPixel(this.found.one.x[this.found.index], this.found.one.y[this.found.index])
        : [figure.box.left + figure.box.width / 2, figure.box.top + figure.box.height / 2];
      const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
      if (event.shiftKey && moves[event.key]) this.move(...moves[event.key]);
      else if (event.key === "ArrowLeft") this.step(-1);
      else if (event.key === "ArrowRight") this.step(1);
      else if (event.key === ".") this.next(1);
      else if (event.key === ",") this.next(-1);
      else if (event.key === "r") this.next(1, (one) => one.refused);
      else if (event.key === "+" || event.key === "=") this.zoom(1.5, middle);
      else if (event.key === "-") this.zoom(1 / 1.5, middle);
      else if (event.key === "0") figure.reset();
      else if (event.key === "Escape") this.point(null);
      else return;
      event.preventDefault();
    }

    zoom(factor, middle) {
      const { found } = this;
      this.figure.zoomBy(factor, ...middle);
      if (found) this.point(found, true);
    }

    move(right, down) {
      const part = ([start, end], by) => {
        const step = Math.min(Math.max(by * (end - start) * 0.15, -start), 100 - end);
        return [start + step, end + step];
      };
      const { zoom } = this.figure;
      this.figure.zoomTo(part(zoom.x, right), part(zoom.y, down));
    }

    async open(mark) {
      const index = this.spec.photos.findIndex((photo) => photo.mark === mark);
      if (index < 0) return;
      await this.choose(index);
      this.place.scrollIntoView({ block: "start" });
      this.figure.root.focus({ preventScroll: true });
    }
  }

  heliogauge.kind("photo", async (place, spec) => {
    const photos = await new Photos(place, spec).begin();
    return { photos, open: (mark) => photos.open(mark) };
  }, (spec) => spec.photos.map((photo) => photo.mark).filter(Boolean));
})();
