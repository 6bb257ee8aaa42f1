// The ten scans in which two methods differ most, at most one per second, so that one jump is listed once.
const TEN = 10;
const APART_MS = 1000;

const orderings = {
  apart: (a, b) => (i) => Math.hypot(a.poses[3 * i] - b.poses[3 * i], a.poses[3 * i + 1] - b.poses[3 * i + 1]),
  error: (a, b) => (i) => (a.error && b.error ? a.error[i] - b.error[i] : NaN),
  step: (a, b) => {
    const [first, second] = [motions(a.poses), motions(b.poses)];
    return (i) => Math.hypot(first[2 * i] - second[2 * i], first[2 * i + 1] - second[2 * i + 1]);
  },
};

// The motion since the previous scan, in the frame of that scan: x, y, x, y (m).
function motions(poses) {
  const moved = new Float64Array(2 * poses.length / 3).fill(NaN);
  for (let i = 3; i < poses.length; i += 3) {
    const [dx, dy] = [poses[i] - poses[i - 3], poses[i + 1] - poses[i - 2]];
    const [cos, sin] = [Math.cos(poses[i - 1]), Math.sin(poses[i - 1])];
    moved[2 * i / 3] = cos * dx + sin * dy;
    moved[2 * i / 3 + 1] = cos * dy - sin * dx;
  }
  return moved;
}

function worstScans(recording, a, b, by) {
  const value = orderings[by](a, b);
  const ranked = Array.from({ length: recording.count }, (_, scan) => ({ scan, value: value(scan) }))
    .filter((found) => found.value > 0)
    .sort((one, other) => other.value - one.value || one.scan - other.scan);
  const listed = [];
  for (const found of ranked) {
    if (listed.length === TEN) break;
    const near = (other) => Math.abs(recording.times[other.scan] - recording.times[found.scan]) < APART_MS;
    if (!listed.some(near)) listed.push(found);
  }
  return listed;
}
