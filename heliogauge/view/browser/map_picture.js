"use strict";
// The picture of a map between its axes: colours of values, of flags and of nodes without a value.
(() => {
  // Those of the static figures: RdBu_r for signed values, viridis from low to high; both safe for the colour-blind.
  const DIVERGING = ["#053061", "#2166ac", "#4393c3", "#92c5de", "#d1e5f0", "#f7f7f7", "#fddbc7", "#f4a582", "#d6604d",
    "#b2182b", "#67001f"];
  const SEQUENTIAL = ["#440154", "#471365", "#482475", "#463480", "#414487", "#3b528b", "#355f8d", "#2f6c8e", "#2a788e",
    "#25848e", "#21918c", "#1e9c89", "#22a884", "#2fb47c", "#44bf70", "#5ec962", "#7ad151", "#9bd93c", "#bddf26", "#dfe318",
    "#fde725"];
  const SHADES = 512;

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

  // Colours of values from low to high.
  function shadesOf(layer, low, high) {
    const stops = layer.diverging ? DIVERGING : SEQUENTIAL;
    return Uint32Array.from({ length: SHADES }, (_, index) => {
      const value = low + (index + 0.5) / SHADES * (high - low);
      return packed(shade(stops, shareOf(value, low, high, layer.diverging)));
    });
  }

  // Colour of each combination of flags; zero where none of its flags is painted.
  function flagColors(data, painted) {
    const colors = new Uint32Array(256);
    data.spec.reasons.forEach((reason, code) => {
      // The rarest flag shows: the common ones would hide it.
      const shown = data.flags.filter((one) => painted.has(one.word) && reason.words.includes(one.word)).pop();
      if (shown) colors[code] = packed(channels(shown.color));
    });
    return colors;
  }

  // Paints what is seen: one look-up for each pixel of the screen, as quick for a million nodes as for a thousand.
  // look: {seen, low, high, shades, ofCode, plain: whether values are left out}.
  function paint(data, look, pixels, width, height, ratio) {
    const { values, codes, aperture, columns, spec } = data;
    const { shades, low, ofCode, seen: { x: [x0, x1], y: [y0, y1] } } = look;
    const places = (count, first, last, origin, step, nodes) => Int32Array.from({ length: count }, (_, at) => {
      const node = Math.round((first + (at + 0.5) / count * (last - first) - origin) / step);
      return node >= 0 && node < nodes ? node : -1;
    });
    const across = places(width, x0, x1, spec.x[0], data.stepX, columns);
    const top = spec.y_down ? [y0, y1] : [y1, y0];
    const down = places(height, ...top, spec.y[0], data.stepY, data.rows);
    const color = heliogauge.colors();
    const [missing, hatch, edge, plain] = [color.missing, color.hatch, color.faint, color.dark ? "#232b33" : "#eef1f4"]
      .map((one) => packed(channels(one)));
    const period = Math.round(8 * ratio);
    const stroke = Math.max(Math.round(1.4 * ratio), 1);
    const scale = SHADES / (look.high - low);
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
          else if (look.plain) pixels[pixel] = plain;
          else {
            const at = (value - low) * scale;
            pixels[pixel] = shades[at < 0 ? 0 : at >= SHADES ? SHADES - 1 : at | 0];
          }
        }
        before = inside;
      }
    }
  }

  // The colour bar, one pixel wide, high values at the top.
  function bar(shades) {
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [1, SHADES];
    const image = new ImageData(1, SHADES);
    new Uint32Array(image.data.buffer).set(shades.slice().reverse());
    canvas.getContext("2d").putImageData(image, 0, 0);
    return canvas;
  }

  heliogauge.mapPicture = { shadesOf, flagColors, paint, bar };
})();
