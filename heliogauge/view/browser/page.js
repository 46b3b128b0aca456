"use strict";
// What all views of a page share: arrays, libraries, colours, and showing each view when the reader comes near it.
const heliogauge = (() => {
  const kinds = new Map(); // kind of view -> function that shows one
  const shown = new Map(); // section -> promise of what the kind returned
  const themeListeners = new Set();

  // ---- arrays and texts, as heliogauge/view/arrays.py packs them ----

  async function bytesOf(text) {
    const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  async function fetched(url) {
    const answer = await fetch(url);
    if (!answer.ok) throw new Error(`${url}: ${answer.status} ${answer.statusText}`);
    return answer.arrayBuffer();
  }

  function fromSteps(planes, shape, step, bits) {
    const count = planes.length / 4;
    const width = shape[shape.length - 1];
    const values = new Float64Array(count);
    let whole = 0;
    for (let index = 0; index < count; index++) {
      if (index % width === 0) whole = 0;
      const folded = (planes[index] | (planes[count + index] << 8) | (planes[2 * count + index] << 16)
        | (planes[3 * count + index] << 24)) >>> 0;
      whole = (whole + ((folded >>> 1) ^ -(folded & 1))) | 0;
      values[index] = bits && !(bits[index >> 3] & (128 >> (index & 7))) ? NaN : whole * step;
    }
    return values;
  }

  // Numbers as a typed array with NaN where there is none; `shape` is in the packed form.
  async function numbers(packed) {
    if (packed.form === "floats") return new Float32Array(await fetched(packed.url));
    const bits = packed.known ? await bytesOf(packed.known) : null;
    return fromSteps(await bytesOf(packed.data), packed.shape, packed.step, bits);
  }

  // Whole numbers from 0 to 255.
  async function codes(packed) {
    return packed.url ? new Uint8Array(await fetched(packed.url)) : bytesOf(packed.data);
  }

  async function text(packed) {
    return new TextDecoder().decode(packed.url ? await fetched(packed.url) : await bytesOf(packed.data));
  }

  // The lines of a text, one for each point; none where there is no text.
  async function lines(packed) {
    return packed ? (await text(packed)).split("\n") : [];
  }

  async function image(packed) {
    const picture = new Image();
    picture.src = packed.url;
    await picture.decode();
    return picture;
  }

  // ---- libraries: compressed in the page's head, run when the first view needs them ----

  const libraries = new Map();

  function library(name) {
    if (!libraries.has(name)) {
      libraries.set(name, (async () => {
        const source = document.querySelector(`script[data-library="${name}"]`);
        if (!source) throw new Error(`the page has no library ${name}`);
        const script = document.createElement("script");
        script.textContent = new TextDecoder().decode(await bytesOf(source.textContent.trim()));
        document.head.append(script);
        return window[name === "three" ? "THREE" : name];
      })());
    }
    return libraries.get(name);
  }

  // ---- colours ----

  function colors() {
    const style = getComputedStyle(document.documentElement);
    const found = {};
    for (const name of ["paper", "ink", "faint", "line", "accent", "missing", "hatch"]) {
      found[name] = style.getPropertyValue(`--${name}`).trim();
    }
    found.dark = isDark();
    return found;
  }

  // A colour made for white paper, lighter where the paper is dark.
  function onPaper(color) {
    if (!isDark() || !/^#[0-9a-f]{6}$/i.test(color)) return color;
    const lighter = [1, 3, 5].map((at) => Math.round(0.62 * parseInt(color.slice(at, at + 2), 16) + 0.38 * 255));
    return `rgb(${lighter.join(", ")})`;
  }

  function isDark() {
    const chosen = document.documentElement.dataset.theme;
    return chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
  }

  // Calls back after every change of the colours.
  function onTheme(listener) {
    themeListeners.add(listener);
  }

  function tellTheme() {
    themeListeners.forEach((listener) => listener());
  }

  function switchTheme() {
    const theme = isDark() ? "light" : "dark";
    document.documentElement.dataset.theme = theme;
    try { localStorage.setItem("heliogauge-theme", theme); } catch { /* pages without storage forget the choice */ }
    tellTheme();
  }

  function startTheme() {
    try {
      const kept = localStorage.getItem("heliogauge-theme");
      if (kept === "dark" || kept === "light") document.documentElement.dataset.theme = kept;
    } catch { /* as the system says */ }
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", tellTheme);
    document.addEventListener("click", (event) => {
      if (event.target.closest("[data-theme-switch]")) switchTheme();
    });
  }

  // ---- elements and numbers ----

  // An element with attributes (functions become listeners of events) and children (texts stay texts).
  function element(tag, attributes = {}, ...children) {
    const made = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) {
      if (typeof value === "function") made.addEventListener(name, value);
      else if (value === true) made.setAttribute(name, "");
      else if (value !== false && value !== null && value !== undefined) made.setAttribute(name, value);
    }
    made.append(...children.filter((child) => child !== null && child !== undefined));
    return made;
  }

  // A number with sensible digits: no float noise, no exponent where it can be avoided, a true minus sign.
  function number(value, digits = 4) {
    if (!Number.isFinite(value)) return "–";
    const size = Math.abs(value);
    const written = size !== 0 && (size < 1e-4 || size >= 1e7)
      ? value.toExponential(Math.max(digits - 1, 0))
      : value.toFixed(size === 0 ? 0 : Math.min(Math.max(digits - 1 - Math.floor(Math.log10(size)), 0), 12));
    return written.replace(/-/g, "\u2212");
  }

  // A number at an axis: no zeros at its end.
  function tick(value) {
    return number(Number(value.toPrecision(6)), 6).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "");
  }

  // A value with the digits that its sigma leaves (two of the sigma), and the sigma.
  function withSigma(value, sigma, unit) {
    const end = unit ? ` ${unit}` : "";
    if (!(sigma > 0) || !Number.isFinite(sigma)) return number(value) + end;
    const places = Math.min(Math.max(1 - Math.floor(Math.log10(sigma)), 0), 12);
    return `${value.toFixed(places)} ± ${sigma.toFixed(places)}${end}`.replace(/-/g, "\u2212");
  }

  // ---- charts of ECharts that follow the size of their place ----

  async function chart(place, resized = () => {}) {
    const echarts = await library("echarts");
    const made = echarts.init(place, null, { renderer: "canvas" });
    new ResizeObserver(() => {
      if (!place.clientWidth) return; // hidden, as on paper
      made.resize();
      resized();
    }).observe(place);
    return made;
  }

  // The look of an axis; `more` adds to it.
  function axis(name, more = {}) {
    const color = colors();
    return {
      type: "value", name, nameLocation: "middle", nameGap: 28, scale: true,
      nameTextStyle: { color: color.ink }, axisLabel: { color: color.ink, hideOverlap: true },
      axisLine: { show: true, onZero: false, lineStyle: { color: color.faint } }, axisTick: { show: true },
      splitLine: { lineStyle: { color: color.line } }, ...more,
    };
  }

  // ---- views ----

  // Registers a kind of view. show(place, spec, section) fills `place`; what it returns may have open(mark), which
  // opens the part that a link "#mark" leads to, and then scrolls there. `marks(spec)` lists these marks.
  // A kind without JSON (tables) is shown in its section itself: place === section, spec === null.
  function kind(name, show, marks = () => []) {
    kinds.set(name, { show, marks });
  }

  function specOf(section) {
    const data = section.querySelector(':scope > script[type="application/json"]');
    return data ? JSON.parse(data.textContent) : null;
  }

  function start(section) {
    if (shown.has(section)) return shown.get(section);
    const { show } = kinds.get(section.dataset.view);
    const done = (async () => {
      const spec = specOf(section);
      let place = section;
      if (spec) {
        place = element("div", { class: "view-live" });
        section.append(place);
      }
      try {
        const made = await show(place, spec, section);
        section.classList.add("alive");
        if (!performance.getEntriesByName("first picture").length) performance.mark("first picture");
        section.dispatchEvent(new Event("shown"));
        return made || {};
      } catch (error) {
        // The static figure stays; the reason is for whoever looks for it.
        if (place !== section) place.remove();
        console.error(`view ${section.getAttribute("aria-label")}:`, error);
        throw error;
      }
    })();
    shown.set(section, done);
    return done;
  }

  // Opens what a link "#mark" leads to where that is a part of a view, such as a photo.
  async function openMark() {
    const mark = decodeURIComponent(location.hash.slice(1));
    if (!mark || document.getElementById(mark)?.offsetParent) return;
    for (const section of document.querySelectorAll("section.view")) {
      const { marks } = kinds.get(section.dataset.view) || {};
      if (!marks || !(section.querySelector(`[id="${CSS.escape(mark)}"]`) || marks(specOf(section)).includes(mark))) continue;
      const made = await start(section);
      if (made.open) await made.open(mark);
      return;
    }
  }

  function startAll() {
    startTheme();
    const watcher = new IntersectionObserver((entries) => {
      for (const { isIntersecting, target } of entries) {
        if (!isIntersecting) continue;
        watcher.unobserve(target);
        start(target).catch(() => {});
      }
    }, { rootMargin: "600px" });
    for (const section of document.querySelectorAll("section.view")) {
      if (kinds.has(section.dataset.view)) watcher.observe(section);
    }
    addEventListener("hashchange", openMark);
    // A link to the mark that is open already changes nothing in the address.
    document.addEventListener("click", (event) => {
      const link = event.target.closest('a[href^="#"]');
      if (link && link.getAttribute("href") === location.hash) openMark();
    });
    openMark();
  }

  document.addEventListener("DOMContentLoaded", startAll);
  return { kind, numbers, codes, text, lines, image, library, chart, axis, colors, onPaper, onTheme, element, number, tick, withSigma };
})();
