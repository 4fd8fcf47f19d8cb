// A clip as the page holds it, unpacked: who is where at a step, and who is bit-identical with whom so far.

class Clip {
  constructor(text) {
    Object.assign(this, JSON.parse(text));
    this.positions = new Float32Array(unpacked(this.positions));
    this.orientations = new Int16Array(unpacked(this.orientations));
    for (const items of this.items)
      for (const item of items) (item.shapes ??= [POINT]).forEach(prepare);
    for (const track of this.tracks) track.items = this.items[track.items];
    [...this.fixed, ...this.ground].forEach(prepare);
  }

  get compared() { return this.classes.reason === undefined; }

  // index of the change of classes that holds at a step
  change(step) { return lastUpTo(this.classes.steps, step); }

  // of each track, the first track that is bit-identical with it so far
  leaders(step) {
    return this.compared ? this.classes.leader[this.change(step)] : this.tracks.map((_, index) => index);
  }

  // row of a track that is drawn at a step: the last recorded one
  row(track, step) { return lastUpTo(track.steps, step); }

  // where an item is: undefined where its position is not finite
  pose(track, row, index) {
    const number = track.poses[row] * track.items.length + index;
    const at = this.positions.subarray(3 * number, 3 * number + 3);
    if (!at.every(Number.isFinite)) return undefined;
    return { at, turn: matrix(this.orientations.subarray(4 * number, 4 * number + 4)) };
  }
}

// what is drawn where nothing is known of a body's shape
const POINT = { kind: "point", size: [0.005], at: [0, 0, 0], turn: [1, 0, 0, 0] };

function unpacked(text) {
  const bytes = atob(text);
  const out = new Uint8Array(bytes.length);
  for (let i = 0; i < bytes.length; i++) out[i] = bytes.charCodeAt(i);
  return out.buffer;
}

// a shape's rotation in its body, undefined where it has none; of faces, which way each looks
function prepare(shape) {
  shape.matrix = shape.turn[0] === 1 ? undefined : matrix(shape.turn);
  shape.normals = shape.faces?.map(([a, b, c]) => {
    const normal = cross(minus(shape.points[b], shape.points[a]), minus(shape.points[c], shape.points[a]));
    const size = Math.hypot(...normal) || 1;
    return normal.map((part) => part / size);
  });
}

// index of the last of increasing numbers that is not above a value; 0 where all are
function lastUpTo(numbers, value) {
  let low = 0, high = numbers.length;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (numbers[middle] <= value) low = middle;
    else high = middle;
  }
  return low;
}

// rotation matrix, row by row, of a quaternion wxyz of any length
function matrix([w, x, y, z]) {
  const s = 2 / (w * w + x * x + y * y + z * z || 1);
  return [
    1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y),
    s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x),
    s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y),
  ];
}

function times(m, n) {
  const out = new Array(9);
  for (let i = 0; i < 3; i++)
    for (let j = 0; j < 3; j++) out[3 * i + j] = m[3 * i] * n[j] + m[3 * i + 1] * n[3 + j] + m[3 * i + 2] * n[6 + j];
  return out;
}

const turned = (m, [x, y, z]) => [
  m[0] * x + m[1] * y + m[2] * z, m[3] * x + m[4] * y + m[5] * z, m[6] * x + m[7] * y + m[8] * z,
];
const turnedBack = (m, [x, y, z]) => [
  m[0] * x + m[3] * y + m[6] * z, m[1] * x + m[4] * y + m[7] * z, m[2] * x + m[5] * y + m[8] * z,
];
const plus = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
