"use strict";
// Scenes: points and lines in space. three.js draws and turns them; this file places them, names what is at the
// pointer, and labels the axes.
(() => {
  // The still picture looks from here, too: heliogauge/view/scenes.py.
  const AZIMUTH = -0.9;
  const ELEVATION = 0.5;
  const FIELD_DEG = 30;
  const REACH_PX = 12;
  const NUDGE_RAD = Math.PI / 24;
  const KEYS = "Drag turns, with Shift or two fingers it moves; the wheel zooms once the scene was clicked (or with Ctrl), two "
    + "fingers always. Keys: arrows turn, Shift and arrows move, + and \u2212 zoom, 0 shows all, 1 from above, 2 along y, 3 along x, "
    + "comma and full stop go from point to point.";
  // Directions to look from: azimuth and elevation.
  const SIDES = [
    ["From above", "1", -Math.PI / 2, Math.PI / 2 - 1e-4],
    ["Along y", "2", -Math.PI / 2, 0],
    ["Along x", "3", 0, 0],
  ];

  const POINT_SHADER = `
    attribute vec3 color; varying vec3 tint; uniform float size;
    void main() { tint = color; gl_PointSize = size; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }`;
  const DISC_SHADER = `
    varying vec3 tint;
    void main() {
      float away = length(gl_PointCoord - 0.5);
      if (away > 0.5) discard;
      gl_FragColor = vec4(away > 0.38 ? tint * 0.72 : tint, 1.0);
    }`;

  // A step of 1, 2 or 5 with which a length has about so many.
  function niceStep(length, count) {
    const rough = length / count;
    const power = 10 ** Math.floor(Math.log10(rough));
    return power * ([1, 2, 5, 10].find((one) => one * power >= rough * 0.999) || 10);
  }

  const rgbOf = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);
  const brightness = (rgb) => 0.2126 * rgb[0] ** 2.2 + 0.7152 * rgb[1] ** 2.2 + 0.0722 * rgb[2] ** 2.2;

  // A colour that is seen on the paper: one that is too near to it is moved towards the ink.
  function visible(rgb, paper, ink) {
    const [light, dark] = [brightness(rgb), brightness(paper)].sort((a, b) => b - a);
    return (light + 0.05) / (dark + 0.05) < 1.9 ? rgb.map((one, index) => 0.35 * one + 0.65 * ink[index]) : rgb;
  }

  class Scene {
    constructor(place, spec) {
      this.place = place;
      this.spec = spec;
      this.found = null;
    }

    async begin() {
      this.THREE = await heliogauge.library("three");
      this.groups = await Promise.all(this.spec.groups.map((one) => this.read(one)));
      this.layOut();
      this.build();
      this.listen();
      this.recolor();
      this.look(AZIMUTH, ELEVATION);
      heliogauge.onTheme(() => this.recolor());
      new ResizeObserver(() => this.resize()).observe(this.root);
      this.resize();
      return this;
    }

    async read(group) {
      const count = group.xyz.shape[1];
      return {
        ...group, count, on: group.shown,
        at: await heliogauge.numbers(group.xyz),
        colorOf: group.color_of ? await heliogauge.numbers(group.color_of) : null,
        texts: await heliogauge.lines(group.labels),
      };
    }

    layOut() {
      const { element } = heliogauge;
      const { spec } = this;
      this.place.append(element("p", { class: "view-title" }, spec.name));
      const entries = this.groups.map((one) => ({
        name: one.name, on: one.on, color: one.colors[0] || "#888888",
        note: one.lengths.length ? `${one.lengths.length} lines` : `${one.count} points`,
      }));
      this.place.append(heliogauge.legend(entries, (index, on) => {
        this.groups[index].on = on;
        this.groups[index].drawn.visible = on;
        this.point(null);
      }, "What is shown"));
      const button = (name, key, action) => element("button", { type: "button", title: `key ${key}`, click: action }, name);
      this.place.append(element("div", { class: "view-bar", role: "group", "aria-label": "Direction of view" },
        button("Whole", "0", () => this.look(AZIMUTH, ELEVATION)),
        ...SIDES.map(([name, key, azimuth, elevation]) => button(name, key, () => this.look(azimuth, elevation)))));
      this.overlay = document.createElementNS("http://www.w3.org/2000/svg", "svg");
      this.overlay.setAttribute("class", "view-overlay");
      this.overlay.setAttribute("aria-hidden", "true");
      this.canvas = element("div", { class: "view-canvas" });
      this.tip = element("div", { class: "view-tip", hidden: true, "aria-hidden": "true" });
      this.root = element("div", {
        class: "view-figure view-scene", tabindex: "0", role: "application", "aria-roledescription": "scene",
        "aria-label": `${spec.name}. Turns with the arrow keys; points by comma and full stop.`,
        style: `--scene-height: ${spec.height}px`,
      }, this.canvas, this.overlay, this.tip);
      this.readout = element("output", { class: "view-readout", "aria-live": "off" });
      this.place.append(this.root, this.readout);
      if (spec.note) this.place.append(element("p", { class: "view-note" }, spec.note));
      this.place.append(element("details", { class: "view-keys" },
        element("summary", {}, "Pointer and keys"), element("p", {}, KEYS)));
    }

    build() {
      const { THREE } = this;
      this.renderer = new THREE.WebGLRenderer({ antialias: true, alpha: true });
      this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
      // Colours go to the screen as they are written.
      this.renderer.outputColorSpace = "srgb-linear";
      this.canvas.append(this.renderer.domElement);
      this.scene = new THREE.Scene();
      this.camera = new THREE.PerspectiveCamera(FIELD_DEG, 1, 0.01, 100);
      this.camera.up.set(0, 0, 1);
      const { middle, size } = this.spec;
      for (const group of this.groups) {
        // About the middle and in shares of the size: 32 bits are then enough wherever the scene lies.
        const places = new Float32Array(3 * group.count);
        for (let index = 0; index < group.count; index++) {
          for (let axis = 0; axis < 3; axis++) {
            places[3 * index + axis] = (group.at[axis * group.count + index] - middle[axis]) / size;
          }
        }
        group.places = places;
        const geometry = new THREE.BufferGeometry();
        geometry.setAttribute("position", new THREE.BufferAttribute(places, 3));
        geometry.setAttribute("color", new THREE.BufferAttribute(new Float32Array(3 * group.count), 3));
        if (group.lengths.length) {
          const pairs = [];
          let first = 0;
          for (const length of group.lengths) {
            for (let index = first; index < first + length - 1; index++) pairs.push(index, index + 1);
            first += length;
          }
          geometry.setIndex(pairs);
          group.drawn = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ vertexColors: true }));
        } else {
          const ratio = this.renderer.getPixelRatio();
          group.drawn = new THREE.Points(geometry, new THREE.ShaderMaterial({
            vertexShader: POINT_SHADER, fragmentShader: DISC_SHADER, uniforms: { size: { value: group.size * ratio * 1.2 } },
          }));
        }
        group.drawn.frustumCulled = false;
        group.drawn.visible = group.on;
        this.scene.add(group.drawn);
      }
      this.frame();
      this.controls = new THREE.OrbitControls(this.camera, this.renderer.domElement);
      this.controls.addEventListener("change", () => this.draw());
      this.renderer.domElement.style.touchAction = "inherit";
    }

    // The box of the coordinates, with a grid of round numbers below.
    frame() {
      const { THREE } = this;
      const low = [Infinity, Infinity, Infinity];
      const high = [-Infinity, -Infinity, -Infinity];
      for (const { at, count } of this.groups) {
        for (let axis = 0; axis < 3; axis++) {
          for (let index = axis * count; index < (axis + 1) * count; index++) {
            if (at[index] < low[axis]) low[axis] = at[index];
            if (at[index] > high[axis]) high[axis] = at[index];
          }
        }
      }
      this.step = niceStep(Math.max(...low.map((one, axis) => high[axis] - one), 1e-9), 6);
      this.low = low;
      this.high = high;
      const lines = [];
      const add = (a, b) => lines.push(...this.toScene(a), ...this.toScene(b));
      const [x0, y0, z0] = this.low;
      const [x1, y1, z1] = this.high;
      for (const x of [x0, ...this.ticks(0), x1]) add([x, y0, z0], [x, y1, z0]);
      for (const y of [y0, ...this.ticks(1), y1]) add([x0, y, z0], [x1, y, z0]);
      if (z1 > z0) for (const x of [x0, x1]) for (const y of [y0, y1]) add([x, y, z0], [x, y, z1]);
      const geometry = new THREE.BufferGeometry();
      geometry.setAttribute("position", new THREE.Float32BufferAttribute(lines, 3));
      this.grid = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial());
      this.grid.frustumCulled = false;
      this.scene.add(this.grid);
    }

    ticks(axis) {
      const first = Math.ceil(this.low[axis] / this.step - 1e-4);
      const last = Math.floor(this.high[axis] / this.step + 1e-4);
      return Array.from({ length: Math.max(last - first + 1, 0) }, (_, index) => (first + index) * this.step || 0);
    }

    toScene(point) {
      return point.map((one, axis) => (one - this.spec.middle[axis]) / this.spec.size);
    }

    recolor() {
      const color = heliogauge.colors();
      const [paper, ink] = [color.paper, color.ink].map((one) => rgbOf(/^#[0-9a-f]{6}$/i.test(one) ? one : "#808080"));
      for (const group of this.groups) {
        const tints = group.colors.map((one) => visible(rgbOf(one), paper, ink));
        const target = group.drawn.geometry.getAttribute("color");
        for (let index = 0; index < group.count; index++) {
          target.array.set(tints[group.colorOf ? Math.round(group.colorOf[index]) : 0], 3 * index);
        }
        target.needsUpdate = true;
      }
      const line = rgbOf(/^#[0-9a-f]{6}$/i.test(color.line) ? color.line : "#808080");
      this.grid.material.color.setRGB(...line, "srgb-linear");
      this.draw();
    }

    // ---- where from ----

    direction(azimuth, elevation) {
      const across = Math.cos(elevation);
      return [across * Math.cos(azimuth), across * Math.sin(azimuth), Math.sin(elevation)];
    }

    // Looks from a direction so that all that is shown fits.
    look(azimuth, elevation) {
      const { camera, controls } = this;
      const towards = this.direction(azimuth, elevation);
      const right = [-Math.sin(azimuth), Math.cos(azimuth), 0];
      const up = [0, 1, 2].map((axis) => towards[(axis + 1) % 3] * right[(axis + 2) % 3] - towards[(axis + 2) % 3] * right[(axis + 1) % 3]);
      const shown = this.groups.filter((one) => one.on);
      const seen = shown.length ? shown : this.groups;
      const low = [Infinity, Infinity, Infinity];
      const high = [-Infinity, -Infinity, -Infinity];
      for (const { places } of seen) {
        for (let index = 0; index < places.length; index++) {
          low[index % 3] = Math.min(low[index % 3], places[index]);
          high[index % 3] = Math.max(high[index % 3], places[index]);
        }
      }
      const middle = low.map((one, axis) => (one + high[axis]) / 2);
      const tall = Math.tan(FIELD_DEG * Math.PI / 360) * 0.84;
      const wide = tall * Math.max(camera.aspect, 0.2);
      let distance = 0.02;
      const corner = (number) => this.toScene([0, 1, 2].map((axis) => (number >> axis) & 1 ? this.high[axis] : this.low[axis]));
      const floor = shown.length === this.groups.length ? [0, 1, 2, 3].flatMap(corner) : [];
      for (const places of [...seen.map((one) => one.places), floor]) {
        for (let index = 0; index < places.length; index += 3) {
          const [x, y, z] = [0, 1, 2].map((axis) => places[index + axis] - middle[axis]);
          const near = x * towards[0] + y * towards[1] + z * towards[2];
          const side = Math.abs(x * right[0] + y * right[1] + z * right[2]) / wide;
          const rise = Math.abs(x * up[0] + y * up[1] + z * up[2]) / tall;
          distance = Math.max(distance, near + Math.max(side, rise));
        }
      }
      controls.target.set(...middle);
      camera.position.set(...middle.map((one, axis) => one + distance * towards[axis]));
      this.turned = false;
      controls.update();
      this.point(null);
    }

    turn(azimuth, elevation) {
      const { camera, controls } = this;
      const away = camera.position.clone().sub(controls.target);
      const distance = away.length();
      const now = [Math.atan2(away.y, away.x), Math.asin(Math.min(Math.max(away.z / distance, -1), 1))];
      const end = Math.PI / 2 - 1e-4;
      const towards = this.direction(now[0] + azimuth, Math.min(Math.max(now[1] + elevation, -end), end));
      camera.position.set(...towards.map((one, axis) => controls.target.getComponent(axis) + distance * one));
      controls.update();
    }

    move(right, up) {
      const { camera, controls, THREE } = this;
      const span = camera.position.distanceTo(controls.target) * 0.05;
      const step = new THREE.Vector3(right * span, up * span, 0).applyQuaternion(camera.quaternion);
      camera.position.add(step);
      controls.target.add(step);
      controls.update();
    }

    zoom(factor) {
      const { camera, controls } = this;
      camera.position.sub(controls.target).divideScalar(factor).add(controls.target);
      controls.update();
    }

    resize() {
      const width = this.root.clientWidth;
      const height = this.root.clientHeight;
      if (!width || !height) return; // hidden, as on paper
      this.renderer.setSize(width, height);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
      // What the reader has turned stays as it is.
      if (!this.turned) this.look(AZIMUTH, ELEVATION);
      this.draw();
    }

    draw() {
      if (this.waiting) return;
      this.waiting = requestAnimationFrame(() => {
        this.waiting = 0;
        const distance = this.camera.position.distanceTo(this.controls.target);
        this.camera.near = Math.max(distance - 3, distance * 1e-3);
        this.camera.far = distance + 3;
        this.camera.updateProjectionMatrix();
        this.renderer.render(this.scene, this.camera);
        this.label();
      });
    }

    // ---- axes ----

    // A place of the scene in the figure [px], with its depth from -1 to 1.
    project(point) {
      const at = new this.THREE.Vector3(...this.toScene(point)).project(this.camera);
      return [(at.x + 1) / 2 * this.root.clientWidth, (1 - at.y) / 2 * this.root.clientHeight, at.z];
    }

    label() {
      const { camera, controls, low, high } = this;
      const color = heliogauge.colors();
      const shapes = [];
      const behind = [0, 1].map((axis) => camera.position.getComponent(axis) < controls.target.getComponent(axis));
      const near = [0, 1].map((axis) => behind[axis] ? low[axis] : high[axis]);
      const middle = this.project([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]]);
      const put = (point, words, anchor, name = false) => {
        const [left, top, depth] = this.project(point);
        if (depth > 1 || left < 0 || top < 0 || left > this.root.clientWidth || top > this.root.clientHeight) return;
        const away = Math.hypot(left - middle[0], top - middle[1]) || 1;
        const [dx, dy] = anchor || [(left - middle[0]) / away * 16, (top - middle[1]) / away * 13];
        shapes.push([left + dx, top + dy + 4, words, anchor ? "end" : "middle", name]);
      };
      const digits = Math.max(0, -Math.floor(Math.log10(this.step) + 1e-9));
      const text = (value) => value.toFixed(digits).replace("-", "\u2212");
      // Labels that would stand closer than 30 px are thinned.
      const thin = (points) => {
        if (points.length < 2) return points;
        const [first, last] = [this.project(points[0]), this.project(points[points.length - 1])];
        const apart = Math.hypot(first[0] - last[0], first[1] - last[1]) / Math.max(points.length - 1, 1);
        const each = Math.max(1, Math.ceil(34 / Math.max(apart, 1)));
        return apart * (points.length - 1) < 40 ? [] : points.filter((_, index) => index % each === 0);
      };
      const along = [
        this.ticks(0).map((x) => [x, near[1], low[2]]),
        this.ticks(1).map((y) => [near[0], y, low[2]]),
      ];
      along.forEach((points, axis) => {
        if (points.length < 2) return;
        const kept = thin(points);
        kept.forEach((point) => put(point, text(point[axis])));
        if (!kept.length) return;
        const half = points[0].map((one, index) => (one + points[points.length - 1][index]) / 2);
        const [left, top] = this.project(half);
        const away = Math.hypot(left - middle[0], top - middle[1]) || 1;
        shapes.push([left + (left - middle[0]) / away * 38, top + (top - middle[1]) / away * 32 + 4, `${"xy"[axis]} [m]`, "middle", true]);
      });
      const heights = this.ticks(2);
      if (heights.length > 1) {
        const corners = [[low[0], low[1]], [low[0], high[1]], [high[0], low[1]], [high[0], high[1]]];
        const left = corners.reduce((best, one) =>
          this.project([...one, low[2]])[0] < this.project([...best, low[2]])[0] ? one : best);
        const points = heights.map((z) => [...left, z]);
        const kept = thin(points);
        kept.forEach((point) => put(point, text(point[2]), [-7, 0]));
        if (kept.length) put([...left, high[2]], "z [m]", [-7, -20], true);
      }
      // Names of axes first: what would cover an earlier label is left out.
      const taken = [];
      const free = shapes.sort((one, other) => Boolean(other[4]) - Boolean(one[4])).filter(([left, top, words, anchor]) => {
        const wide = 7 * words.length + 4;
        const first = anchor === "end" ? left - wide : left - wide / 2;
        const box = [first, top - 13, first + wide, top + 4];
        const covers = taken.some((other) => box[0] < other[2] && box[2] > other[0] && box[1] < other[3] && box[3] > other[1]);
        if (!covers) taken.push(box);
        return !covers;
      });
      const made = free.map(([left, top, words, anchor, name]) => {
        const label = document.createElementNS("http://www.w3.org/2000/svg", "text");
        const looks = { x: left.toFixed(1), y: top.toFixed(1), "text-anchor": anchor, "font-size": 12, fill: name ? color.ink : color.faint,
          stroke: color.paper, "stroke-width": 3, "paint-order": "stroke" };
        for (const [key, value] of Object.entries(looks)) label.setAttribute(key, value);
        label.textContent = words;
        return label;
      });
      if (this.found) made.push(this.ring(color));
      this.overlay.replaceChildren(...made);
    }

    ring(color) {
      const { group, index } = this.found;
      const [left, top] = this.project([0, 1, 2].map((axis) => group.at[axis * group.count + index]));
      const ring = document.createElementNS("http://www.w3.org/2000/svg", "circle");
      const looks = { cx: left, cy: top, r: group.size / 2 + 4, fill: "none", stroke: color.ink, "stroke-width": 2 };
      for (const [key, value] of Object.entries(looks)) ring.setAttribute(key, value);
      return ring;
    }

    // ---- what is at the pointer ----

    nearest(left, top) {
      const width = this.root.clientWidth;
      const height = this.root.clientHeight;
      const { camera } = this;
      camera.updateMatrixWorld();
      const matrix = camera.projectionMatrix.clone().multiply(camera.matrixWorldInverse).elements;
      let best = null;
      let least = Infinity;
      for (const group of this.groups) {
        // Lines without names are there to be seen, not to be asked.
        if (!group.on || (group.lengths.length && !group.texts.length)) continue;
        const { places } = group;
        for (let index = 0; index < group.count; index++) {
          const x = places[3 * index];
          const y = places[3 * index + 1];
          const z = places[3 * index + 2];
          const w = matrix[3] * x + matrix[7] * y + matrix[11] * z + matrix[15];
          if (w <= 0) continue;
          const across = ((matrix[0] * x + matrix[4] * y + matrix[8] * z + matrix[12]) / w + 1) / 2 * width - left;
          const down = (1 - (matrix[1] * x + matrix[5] * y + matrix[9] * z + matrix[13]) / w) / 2 * height - top;
          const away = Math.hypot(across, down);
          if (away > REACH_PX) continue;
          // Of two at the same place the nearer one is meant.
          const weight = away + 3 * w;
          if (weight < least) {
            least = weight;
            best = { group, index };
          }
        }
      }
      return best;
    }

    words({ group, index }) {
      const at = [0, 1, 2].map((axis) => group.at[axis * group.count + index]);
      // A ten-thousandth of the scene is what the eye can tell; a tenth of a millimetre what a reader wants.
      const digits = Math.min(Math.max(4 - Math.floor(Math.log10(this.spec.size)), 0), 7);
      const text = at.map((one) => one.toFixed(digits).replace("-", "\u2212")).join(", ");
      return [group.texts[index] || group.name, `x, y, z = ${text} m`, ...(group.texts[index] ? [group.name] : [])];
    }

    point(found, aloud = false) {
      this.found = found;
      this.readout.setAttribute("aria-live", aloud ? "polite" : "off");
      if (found) {
        const words = this.words(found);
        const { group, index } = found;
        const [left, top] = this.project([0, 1, 2].map((axis) => group.at[axis * group.count + index]));
        this.tip.replaceChildren(...words.map((line) => heliogauge.element("div", {}, line)));
        this.tip.hidden = false;
        const beside = left + 16 + this.tip.offsetWidth > this.root.clientWidth ? left - 12 - this.tip.offsetWidth : left + 16;
        const below = top + 18 + this.tip.offsetHeight > this.root.clientHeight ? top - 12 - this.tip.offsetHeight : top + 18;
        this.tip.style.transform = `translate(${Math.max(beside, 0)}px, ${Math.max(below, 0)}px)`;
        this.readout.textContent = words.join("; ");
      } else {
        this.tip.hidden = true;
        this.readout.textContent = "";
      }
      this.draw();
    }

    // Goes to the next point of what is shown.
    next(by) {
      const asked = this.groups.filter((one) => one.on && one.count && (!one.lengths.length || one.texts.length));
      if (!asked.length) return;
      let { group, index } = this.found || { group: asked[0], index: by > 0 ? -1 : 0 };
      index += by;
      if (index < 0 || index >= group.count) {
        group = asked[(asked.indexOf(group) + by + asked.length) % asked.length];
        index = by > 0 ? 0 : group.count - 1;
      }
      this.point({ group, index }, true);
    }

    listen() {
      const { root, controls } = this;
      const active = () => document.activeElement === root;
      root.addEventListener("pointerdown", () => root.focus({ preventScroll: true }));
      root.addEventListener("focus", () => root.classList.add("active"));
      root.addEventListener("blur", () => root.classList.remove("active"));
      // The wheel scrolls the page until the reader has chosen this scene.
      root.addEventListener("wheel", (event) => {
        controls.enableZoom = active() || event.ctrlKey;
      }, { capture: true, passive: true });
      controls.addEventListener("start", () => {
        controls.enableZoom = true;
        this.turned = true;
        this.point(null);
      });
      root.addEventListener("pointermove", (event) => {
        if (event.buttons) return;
        const box = root.getBoundingClientRect();
        this.point(this.nearest(event.clientX - box.left, event.clientY - box.top));
      });
      root.addEventListener("click", (event) => {
        const box = root.getBoundingClientRect();
        this.point(this.nearest(event.clientX - box.left, event.clientY - box.top));
      });
      root.addEventListener("pointerleave", () => this.point(null));
      root.addEventListener("keydown", (event) => this.key(event));
    }

    key(event) {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
      const arrow = arrows[event.key];
      const side = SIDES.find(([, key]) => key === event.key);
      if (arrow && event.shiftKey) this.move(...arrow);
      else if (arrow) this.turn(arrow[0] * NUDGE_RAD, arrow[1] * NUDGE_RAD);
      else if (event.key === "+" || event.key === "=") this.zoom(1.25);
      else if (event.key === "-") this.zoom(1 / 1.25);
      else if (event.key === "0") this.look(AZIMUTH, ELEVATION);
      else if (side) this.look(side[2], side[3]);
      else if (event.key === ".") this.next(1);
      else if (event.key === ",") this.next(-1);
      else if (event.key === "Escape") this.point(null);
      else return;
      if (arrow || "+=-".includes(event.key)) {
        this.turned = true;
        if (this.found) this.point(this.found, true);
      }
      event.preventDefault();
    }
  }

  heliogauge.kind("scene", async (place, spec) => {
    const scene = await new Scene(place, spec).begin();
    return { scene };
  });
})();
