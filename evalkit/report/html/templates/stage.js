// Draws the player's map: the picture of a map, paths, placed scans, ghost walls, violations, residuals, scale bar.
const RAMP = ["#f0d21f", "#f89540", "#cc4778", "#7e03a8", "#0d0887"]; // plasma, dark is bad: readable by lightness alone
const FAR_M = 0.3;
const GHOST = "#e69f00";
const VIOLATION = "#8b1fa9";
const SIDES = { after: { colour: "#3d1fd1", dash: [] }, before: { colour: "#c8102e", dash: [7, 5] } }; // colours of no method

const ramp = (share) => RAMP[Math.min(Math.floor(Math.max(share, 0) * RAMP.length), RAMP.length - 1)];

// Distance (pixels) of every pixel of a map's picture to the nearest occupied one, by two passes of a chamfer mask.
function wallDistances(image) {
  const [width, height] = [image.naturalWidth, image.naturalHeight];
  const canvas = new OffscreenCanvas(width, height);
  const brush = canvas.getContext("2d", { willReadFrequently: true });
  brush.drawImage(image, 0, 0);
  const grey = brush.getImageData(0, 0, width, height).data;
  const far = new Float32Array(width * height).fill(1e6);
  const nearer = (at, column, row, dx, dy) => {
    const [c, r] = [column + dx, row + dy];
    if (c >= 0 && r >= 0 && c < width && r < height) far[at] = Math.min(far[at], far[r * width + c] + Math.hypot(dx, dy));
  };
  for (let at = 0; at < far.length; at++) {
    const [column, row] = [at % width, Math.floor(at / width)];
    if (grey[4 * at] < 80) far[at] = 0;
    for (const [dx, dy] of [[-1, 0], [-1, -1], [0, -1], [1, -1]]) nearer(at, column, row, dx, dy);
  }
  for (let at = far.length - 1; at >= 0; at--) {
    const [column, row] = [at % width, Math.floor(at / width)];
    for (const [dx, dy] of [[1, 0], [1, 1], [0, 1], [-1, 1]]) nearer(at, column, row, dx, dy);
  }
  return { far, width, height };
}

class Stage {
  constructor(canvas, recording, pictures) {
    Object.assign(this, { canvas, recording, pictures, distances: new Map() });
  }

  draw(view, state) {
    const brush = resized(this.canvas);
    this.map(brush, view, state.map);
    const chosen = state.runs.find((run) => run.label === state.first);
    const alone = this.recording.maps.find((one) => one.label === state.map);
    if (state.layers.ghosts && (alone ?? chosen)) this.squares(brush, view, alone ?? chosen);
    if (state.layers.violations && chosen) this.crosses(brush, view, chosen);
    const { truth } = this.recording;
    if (state.layers.truth && truth) this.path(brush, view, truth, state.scan, 2.6);
    const strong = state.correction ? 0.35 : 1; // other paths step back
    if (state.layers.estimates) for (const run of state.runs) this.path(brush, view, run, state.scan, 1.5, strong);
    if (state.correction) this.correction(brush, view, state.correction, state.side);
    if (state.layers.residuals && chosen) this.residuals(brush, view, chosen, state.quantity);
    const placers = [state.second, state.first].map((label) => (label === "truth" ? truth : this.recording.runs.find((run) => run.label === label)));
    placers.forEach((run, i) => run && this.scan(brush, view, run, state, placers[1] && i === 0));
    for (const run of state.runs) this.robot(brush, view, run, state.scan);
    this.scaleBar(brush, view);
    if (state.layers.distances) this.key(brush, view, "to the nearest wall", FAR_M);
  }

  map(brush, view, label) {
    const { window: shown, pixels } = this.recording;
    const image = this.pictures.get(label);
    if (!shown || !image?.naturalWidth) return;
    const side = pixels[label] * view.scale;
    const [left, top] = view.toScreen(shown[0], shown[3]);
    brush.imageSmoothingEnabled = side < 1;
    brush.filter = isDark() ? "invert(1)" : "none";
    brush.drawImage(image, left, top, image.naturalWidth * side, image.naturalHeight * side);
    brush.filter = "none";
  }

  squares(brush, view, run) {
    const side = Math.max(run.cell * view.scale, 3);
    brush.fillStyle = GHOST;
    for (let i = 0; i < (run.ghosts?.length ?? 0); i += 2) {
      const [x, y] = view.toScreen(run.ghosts[i], run.ghosts[i + 1]);
      brush.fillRect(x - side / 2, y - side / 2, side, side);
    }
  }

  crosses(brush, view, run) {
    const arm = Math.max(0.5 * run.cell * view.scale, 2);
    brush.strokeStyle = VIOLATION;
    brush.lineWidth = 1.2;
    brush.beginPath();
    for (let i = 0; i < (run.violations?.length ?? 0); i += 2) {
      const [x, y] = view.toScreen(run.violations[i], run.violations[i + 1]);
      brush.moveTo(x - arm, y - arm);
      brush.lineTo(x + arm, y + arm);
      brush.moveTo(x - arm, y + arm);
      brush.lineTo(x + arm, y - arm);
    }
    brush.stroke();
  }

  // The path up to the current scan is opaque, the rest faint.
  path(brush, view, run, scan, width, strong = 1) {
    const line = (from, to) => {
      brush.beginPath();
      for (let i = from, pen = false; i <= to; i++) {
        const there = !Number.isNaN(run.poses[3 * i]);
        if (there) brush[pen ? "lineTo" : "moveTo"](...view.toScreen(run.poses[3 * i], run.poses[3 * i + 1]));
        pen = there;
      }
      brush.stroke();
    };
    brush.strokeStyle = paint(run.colour);
    brush.lineWidth = width;
    brush.setLineDash(run.dash.map((length) => 1.4 * length));
    brush.globalAlpha = 0.28 * strong;
    line(scan, this.recording.count - 1);
    brush.globalAlpha = strong;
    line(0, scan);
    brush.globalAlpha = 1;
    brush.setLineDash([]);
  }

  // The path just before or after a correction, or both, with the edges of its closures and where the robot was.
  // Of both, the dashes of that before lie on that after: where they agree, both are visible.
  correction(brush, view, one, side) {
    for (const [name, { colour, dash }] of Object.entries(SIDES)) {
      if (side !== name && side !== "both") continue;
      const path = one[name];
      const drawn = [Array.from({ length: path.length / 2 }, (_, i) => path.subarray(2 * i, 2 * i + 2)), ...one.edges[name].map((edge) => [edge.slice(0, 2), edge.slice(2)])];
      drawn.forEach((points, i) => {
        brush.beginPath();
        for (const point of points) brush.lineTo(...view.toScreen(...point));
        const casing = name === "before" && side === "both" ? [] : [["#fff", 4.6]];
        for (const [ink, width] of [...casing, [colour, i === 1 ? 3 : i ? 1.5 : 2.2]]) {
          brush.setLineDash(i || ink === "#fff" ? [] : dash);
          brush.strokeStyle = ink;
          brush.lineWidth = width;
          brush.stroke();
        }
      });
      brush.setLineDash([]);
      for (const point of [drawn[0].at(-1), ...drawn.slice(1).flat()]) {
        brush.beginPath();
        brush.arc(...view.toScreen(...point), 4.5, 0, 7);
        brush.fillStyle = colour;
        brush.fill();
        brush.strokeStyle = "#fff";
        brush.lineWidth = 1.2;
        brush.stroke();
      }
    }
  }

  residuals(brush, view, run, quantity) {
    const values = run[quantity];
    if (!values) return;
    const most = upper(values);
    for (let i = 0; i < this.recording.count; i++) {
      if (Number.isNaN(values[i]) || Number.isNaN(run.poses[3 * i])) continue;
      brush.fillStyle = ramp(values[i] / most);
      brush.beginPath();
      brush.arc(...view.toScreen(run.poses[3 * i], run.poses[3 * i + 1]), 3.2, 0, 7);
      brush.fill();
    }
    this.key(brush, view, { s2s: "S2S residual", s2m: "S2M residual", error: "error" }[quantity], most, 26);
  }

  // The second scan is hollow: colour alone does not distinguish them for every reader.
  scan(brush, view, run, state, hollow) {
    if (!this.recording.beams) return;
    const points = placeScan(this.recording, run.poses, state.scan);
    const radius = Math.min(Math.max(0.02 * view.scale, 1.8), 4);
    const field = state.layers.distances && this.distance(state.map);
    const dots = (size, colour) => {
      for (let i = 0; i < points.length; i += 2) {
        if (Number.isNaN(points[i])) continue;
        brush.fillStyle = colour(i);
        brush.beginPath();
        brush.arc(...view.toScreen(points[i], points[i + 1]), size, 0, 7);
        brush.fill();
      }
    };
    const own = paint(run.colour);
    const colour = (i) => (field ? ramp(this.lookUp(field, state.map, points[i], points[i + 1]) / FAR_M) : own);
    const wide = hollow ? radius + 1.4 : radius;
    dots(wide + 1.2, () => "#fff"); // distinct from walls and from grey
    dots(wide, colour);
    if (hollow) dots(wide - 1.5, () => "#fff");
  }

  distance(label) {
    const image = this.pictures.get(label);
    if (!this.distances.has(label) && image?.naturalWidth) this.distances.set(label, wallDistances(image));
    return this.distances.get(label);
  }

  lookUp(field, label, x, y) {
    const side = this.recording.pixels[label];
    const column = Math.floor((x - this.recording.window[0]) / side);
    const row = Math.floor((this.recording.window[3] - y) / side);
    const inside = column >= 0 && row >= 0 && column < field.width && row < field.height;
    return inside ? field.far[row * field.width + column] * side : FAR_M;
  }

  robot(brush, view, run, scan) {
    const [x, y, theta] = run.poses.subarray(3 * scan, 3 * scan + 3);
    if (Number.isNaN(x)) return;
    brush.save();
    brush.translate(...view.toScreen(x, y));
    brush.rotate(-theta);
    brush.beginPath();
    for (const corner of [[11, 0], [-6, 6], [-3, 0], [-6, -6]]) brush.lineTo(...corner);
    brush.closePath();
    brush.fillStyle = paint(run.colour);
    brush.strokeStyle = "#fff";
    brush.lineWidth = 1.5;
    brush.stroke();
    brush.fill();
    brush.restore();
  }

  scaleBar(brush, view) {
    const [, height] = view.size;
    const length = view.bar;
    const written = length >= 1 ? `${length} m` : `${Math.round(length * 1000) / 10} cm`;
    brush.fillStyle = "rgb(255 255 255 / 0.85)";
    brush.fillRect(8, height - 32, length * view.scale + 12, 26);
    brush.fillStyle = "#1c2128";
    brush.fillRect(14, height - 13, length * view.scale, 3);
    brush.font = "600 12px system-ui, sans-serif";
    brush.fillText(written, 14, height - 18);
  }

  key(brush, view, words, most, up = 0) {
    const [width, height] = view.size;
    brush.font = "12px system-ui, sans-serif";
    const text = `0 to ${(1000 * most).toFixed(0)} mm ${words}`;
    const side = 14;
    const left = width - brush.measureText(text).width - RAMP.length * side - 22;
    brush.fillStyle = "rgb(255 255 255 / 0.85)";
    brush.fillRect(left - 6, height - 30 - up, width - left, 24);
    RAMP.forEach((colour, i) => {
      brush.fillStyle = colour;
      brush.fillRect(left + i * side, height - 24 - up, side, 12);
    });
    brush.fillStyle = "#1c2128";
    brush.fillText(text, left + RAMP.length * side + 6, height - 14 - up);
  }
}

// The canvas cleared, as sharp as the screen: its brush works in CSS pixels.
function resized(canvas) {
  const sharp = window.devicePixelRatio || 1;
  const [width, height] = [Math.round(canvas.clientWidth * sharp), Math.round(canvas.clientHeight * sharp)];
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const brush = canvas.getContext("2d");
  brush.setTransform(sharp, 0, 0, sharp, 0, 0);
  brush.clearRect(0, 0, canvas.clientWidth, canvas.clientHeight);
  return brush;
}

// The 98 % quantile of the values.
const uppers = new WeakMap();
function upper(values) {
  if (!uppers.has(values)) {
    const finite = values.filter((value) => !Number.isNaN(value)).sort();
    uppers.set(values, finite[Math.floor(0.98 * (finite.length - 1))] || 1e-3);
  }
  return uppers.get(values);
}
