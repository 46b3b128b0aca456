"use strict";
// A figure with axes that zooms and moves: ECharts draws axes and series and reads wheel, drag and pinch; this file
// keeps what maps, charts and photos share: place of the axes, pointer and keyboard, tip, overlay, legend.
(() => {
  const SVG = "http://www.w3.org/2000/svg";
  // Zoomed in until 0.2 % of an axis fill the figure, unless the view says otherwise.
  const LEAST_SPAN = 0.2;

  class Figure {
    // label: what it shows, for those who cannot see it. keys: what the keyboard does, in words.
    constructor(place, label, keys) {
      this.canvas = heliogauge.element("div", { class: "view-canvas" });
      this.overlay = document.createElementNS(SVG, "svg");
      this.overlay.setAttribute("class", "view-overlay");
      this.overlay.setAttribute("aria-hidden", "true");
      this.tip = heliogauge.element("div", { class: "view-tip", hidden: true, "aria-hidden": "true" });
      this.root = heliogauge.element(
        "div",
        { class: "view-figure", tabindex: "0", role: "application", "aria-label": label, "aria-roledescription": "figure" },
        this.canvas, this.overlay, this.tip,
      );
      const help = heliogauge.element("details", { class: "view-keys" },
        heliogauge.element("summary", {}, "Pointer and keys"), heliogauge.element("p", {}, keys));
      place.append(this.root, help);
      this.zoom = { x: [0, 100], y: [0, 100] };
      this.box = { left: 0, top: 0, width: 1, height: 1 };
      this.x = [0, 1];
      this.y = [0, 1];
      this.yDown = false;
      this.leastSpan = LEAST_SPAN;
      this.onZoom = () => {};
      this.onResize = () => {};
    }

    async begin() {
      this.chart = await heliogauge.chart(this.canvas, () => this.onResize());
      this.chart.on("datazoom", (event) => {
        for (const one of event.batch || [event]) {
          if (one.dataZoomId === "x" || one.dataZoomId === "y") this.zoom[one.dataZoomId] = [one.start, one.end];
        }
        this.hideTip();
        this.onZoom();
      });
      // The wheel scrolls the page until the reader has chosen this figure; likewise a finger.
      this.root.addEventListener("pointerdown", () => this.root.focus({ preventScroll: true }));
      this.root.addEventListener("focus", () => this.root.classList.add("active"));
      this.root.addEventListener("blur", () => this.root.classList.remove("active"));
      const wheel = (event) => { if (!this.active && !event.ctrlKey) event.stopPropagation(); };
      for (const name of ["wheel", "mousewheel"]) this.root.addEventListener(name, wheel, { capture: true, passive: true });
      this.root.addEventListener("dblclick", () => this.reset());
      this.root.addEventListener("pointerleave", () => this.hideTip());
      return this;
    }

    get active() {
      return document.activeElement === this.root;
    }

    // Sets the place of the axes in pixels and their ranges; more: parts of the two axes.
    axes(box, x, y, more) {
      Object.assign(this, { box, x, y, yDown: Boolean(more.yDown) });
      const zoom = (id) => ({
        id, type: "inside", filterMode: "none", [`${id}AxisIndex`]: 0, start: this.zoom[id][0], end: this.zoom[id][1],
        minSpan: this.leastSpan, zoomOnMouseWheel: true, moveOnMouseMove: true,
        preventDefaultMouseMove: false,
      });
      return {
        animation: false,
        grid: [{ left: box.left, top: box.top, width: box.width, height: box.height }],
        xAxis: [heliogauge.axis(more.xName, { min: x[0], max: x[1], ...more.xAxis })],
        yAxis: [heliogauge.axis(more.yName, { min: y[0], max: y[1], inverse: this.yDown, nameGap: 44, ...more.yAxis })],
        dataZoom: [zoom("x"), zoom("y")],
      };
    }

    // What is seen of the axes: [first, last] of each.
    seen() {
      const part = ([low, high], [start, end]) => [low + (high - low) * start / 100, low + (high - low) * end / 100];
      return { x: part(this.x, this.zoom.x), y: part(this.y, this.zoom.y) };
    }

    toPixel(x, y) {
      const { x: [x0, x1], y: [y0, y1] } = this.seen();
      const down = (y - y0) / (y1 - y0);
      return [
        this.box.left + (x - x0) / (x1 - x0) * this.box.width,
        this.box.top + (this.yDown ? down : 1 - down) * this.box.height,
      ];
    }

    toData(left, top) {
      const { x: [x0, x1], y: [y0, y1] } = this.seen();
      const down = (top - this.box.top) / this.box.height;
      return [
        x0 + (left - this.box.left) / this.box.width * (x1 - x0),
        y0 + (this.yDown ? down : 1 - down) * (y1 - y0),
      ];
    }

    // Place of an event within the figure [px], and whether it is within the axes.
    placeOf(event) {
      const frame = this.root.getBoundingClientRect();
      const left = event.clientX - frame.left;
      const top = event.clientY - frame.top;
      const { box } = this;
      const within = left >= box.left && left <= box.left + box.width && top >= box.top && top <= box.top + box.height;
      return { left, top, within };
    }

    // Zooms by a factor (2: twice as large) about a place of the figure [px].
    zoomBy(factor, left, top) {
      const shareX = (left - this.box.left) / this.box.width;
      const down = (top - this.box.top) / this.box.height;
      const next = (([start, end], share) => {
        const span = Math.min(Math.max((end - start) / factor, this.leastSpan), 100);
        const first = Math.min(Math.max(start + (end - start - span) * share, 0), 100 - span);
        return [first, first + span];
      });
      this.zoomTo(next(this.zoom.x, shareX), next(this.zoom.y, this.yDown ? down : 1 - down));
    }

    zoomTo(x, y) {
      const part = (id, [start, end]) => ({ dataZoomId: id, start, end });
      this.chart.dispatchAction({ type: "dataZoom", batch: [part("x", x), part("y", y)] });
    }

    reset() {
      this.zoomTo([0, 100], [0, 100]);
    }

    // Moves what is seen just so far that a place of the data is within it.
    follow(x, y) {
      const moved = (at, [low, high], [start, end]) => {
        const share = 100 * (at - low) / (high - low);
        const by = Math.min(share - start, 0) || Math.max(share - end, 0);
        return by === 0 ? [start, end] : [start + by, end + by].map((one) => Math.min(Math.max(one, 0), 100));
      };
      const next = [moved(x, this.x, this.zoom.x), moved(y, this.y, this.zoom.y)];
      if (next[0][0] !== this.zoom.x[0] || next[1][0] !== this.zoom.y[0]) this.zoomTo(...next);
    }

    showTip(left, top, ...lines) {
      this.tip.replaceChildren(...lines.map((line) => heliogauge.element("div", {}, line)));
      this.tip.hidden = false;
      const { clientWidth, clientHeight } = this.root;
      const beside = left + 16 + this.tip.offsetWidth > clientWidth ? left - 12 - this.tip.offsetWidth : left + 16;
      const above = top + 18 + this.tip.offsetHeight > clientHeight ? top - 12 - this.tip.offsetHeight : top + 18;
      this.tip.style.transform = `translate(${Math.max(beside, 0)}px, ${Math.max(above, 0)}px)`;
    }

    hideTip() {
      this.tip.hidden = true;
    }

    // Replaces what lies over the figure: [tag, attributes, text] each, in pixels; cut off just outside the axes.
    drawOver(shapes) {
      const { left, top, width, height } = this.box;
      const spare = 7;
      const frame = this.root.getBoundingClientRect();
      this.overlay.style.clipPath = `inset(${Math.max(top - spare, 0)}px ${Math.max(frame.width - left - width - spare, 0)}px `
        + `${Math.max(frame.height - top - height - spare, 0)}px ${Math.max(left - spare, 0)}px)`;
      this.overlay.replaceChildren(...shapes.map(([tag, attributes, text]) => {
        const shape = document.createElementNS(SVG, tag);
        Object.entries(attributes).forEach(([name, value]) => shape.setAttribute(name, value));
        if (text) shape.textContent = text;
        return shape;
      }));
    }
  }

  // A legend of switches: entries {name, color, on, note}; toggle(index, on) after each press.
  function legend(entries, toggle, label) {
    const bar = heliogauge.element("div", { class: "view-bar view-legend", role: "group", "aria-label": label });
    entries.forEach((entry, index) => {
      const button = heliogauge.element("button", {
        type: "button", "aria-pressed": String(entry.on), title: entry.note || null,
        click: () => {
          entry.on = !entry.on;
          button.setAttribute("aria-pressed", String(entry.on));
          toggle(index, entry.on);
        },
      }, heliogauge.element("span", { class: "view-swatch", style: `--swatch: ${entry.color}` }), entry.name);
      bar.append(button);
    });
    return bar;
  }

  heliogauge.figure = (place, label, keys) => new Figure(place, label, keys).begin();
  heliogauge.legend = legend;
})();
