// Reads a sequence for the player: decodes the texts of array_encoding.py (base64, deflate, folded differences).
const NONE = -2147483648;

async function unpack(text, columns = 1) {
  const letters = atob(text);
  const bytes = new Uint8Array(letters.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = letters.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const steps = new Int32Array(planes.length / 4);
  const [second, third, fourth] = [1, 2, 3].map((plane) => plane * steps.length);
  for (let i = 0; i < steps.length; i++) {
    const folded = planes[i] | (planes[i + second] << 8) | (planes[i + third] << 16) | (planes[i + fourth] << 24);
    steps[i] = (i < columns ? 0 : steps[i - columns]) + ((folded >>> 1) ^ -(folded & 1));
  }
  return steps;
}

const inUnits = (steps, ...units) => Float64Array.from(steps, (n, i) => (n === NONE ? NaN : n * units[i % units.length]));
const poses = async (text) => inUnits(await unpack(text, 3), 1e-3, 1e-3, 1e-5);
const series = async (text) => (text === null ? null : inUnits(await unpack(text), 1e-4));
const cells = async (text) => (text === null ? null : inUnits(await unpack(text, 2), 1e-3));

// The paths before and after a correction (x, y, x, y, in m) from rows of x, y before and what was added, in mm.
function sides(steps) {
  const of = (value) => Float64Array.from({ length: steps.length / 2 }, (_, i) => 1e-3 * value(4 * (i >> 1) + (i & 1)));
  return { before: of((at) => steps[at]), after: of((at) => steps[at] + steps[at + 2]) };
}

async function readRecording(text) {
  const raw = JSON.parse(text);
  const runs = await Promise.all(raw.runs.map(async (run) => ({
    ...run,
    poses: await poses(run.poses),
    s2s: await series(run.s2s),
    s2m: await series(run.s2m),
    error: await series(run.error),
    ghosts: await cells(run.ghosts),
    violations: await cells(run.violations),
  })));
  const beams = raw.beams && {
    width: raw.beams.width,
    ranges: await unpack(raw.beams.ranges),
    angles: await unpack(raw.beams.angles, raw.beams.width),
    sensor: await poses(raw.beams.sensor),
    sweep: await unpack(raw.beams.sweep),
  };
  const times = await unpack(raw.times);
  const truth = raw.truth && { label: "", colour: "var(--ink)", dash: [], poses: await poses(raw.truth) };
  const corrections = await Promise.all(raw.corrections.map(async (one) => ({ ...one, ...sides(await unpack(one.path, 4)) })));
  return { ...raw, runs, corrections, beams, times, truth, numbers: await unpack(raw.numbers), count: times.length };
}

// The hits of scan i in the world for one trajectory, as x, y, x, y (m), NaN without a hit; as place_hits() of player.py.
function placeScan(recording, trajectory, i) {
  const { width, ranges, angles, sensor, sweep } = recording.beams;
  const points = new Float64Array(2 * width).fill(NaN);
  const [x, y, theta] = trajectory.subarray(3 * i, 3 * i + 3);
  if (Number.isNaN(x)) return points;
  const after = Math.min(i + 1, recording.count - 1);
  const before = Math.max(after - 1, 0);
  const step = [0, 1, 2].map((axis) => trajectory[3 * after + axis] - trajectory[3 * before + axis]);
  step[2] = Math.atan2(Math.sin(step[2]), Math.cos(step[2]));
  const moves = Number.isNaN(step[0]) ? 0 : Math.min(sweep[i] / Math.max(recording.times[after] - recording.times[before], 1), 1);
  const [sx, sy, turned] = sensor.subarray(3 * i, 3 * i + 3);
  for (let beam = 0; beam < width; beam++) {
    const range = ranges[i * width + beam] * 1e-3;
    if (!(range > 0)) continue;
    const share = moves * beam / Math.max(width - 1, 1);
    const angle = angles[i * width + beam] * 1e-5 + turned;
    const [bx, by] = [sx + range * Math.cos(angle), sy + range * Math.sin(angle)];
    const heading = theta + (share && share * step[2]);
    const [cos, sin] = [Math.cos(heading), Math.sin(heading)];
    points[2 * beam] = x + (share && share * step[0]) + cos * bx - sin * by;
    points[2 * beam + 1] = y + (share && share * step[1]) + sin * bx + cos * by;
  }
  return points;
}
