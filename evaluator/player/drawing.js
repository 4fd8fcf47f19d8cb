// Solids on a 2D canvas, back to front. Coordinates are metres in the environment's frame, z up.

const VIEW_ANGLE = 0.6; // of the canvas's height [rad]
const WIDE = 1.45; // width of a picture that is as high as it can be, in heights
const MARGIN = 0.94; // of half a picture that what is looked at takes
const NEAR = 0.02; // share of the camera's distance in front of which nothing is drawn
const LIGHT = [0.36, -0.48, 0.8];
const GRID = 0.1; // lines on the ground [m]
const DASHES = [[], [5, 3], [1.5, 2.5], [9, 3, 2, 3], [3, 5], [12, 4], [6, 2, 2, 2, 2, 2], [2, 6]];

class Camera {
  constructor(low, high) {
    this.low = low;
    this.high = high;
    this.reset();
  }

  reset() {
    this.target = plus(this.low, this.high).map((sum) => sum / 2);
    this.azimuth = -1.1;
    this.height = 0.5;
    this.face();
    // as near as all corners of the box stay in the picture
    const [side, top] = [WIDE * MARGIN, MARGIN].map((share) => share * Math.tan(VIEW_ANGLE / 2));
    this.distance = Math.max(0.05, ...[0, 1, 2, 3, 4, 5, 6, 7].map((corner) => {
      const v = minus([0, 1, 2].map((axis) => (corner >> axis & 1 ? this.high : this.low)[axis]), this.target);
      const depth = dot(v, this.forward);
      return Math.max(Math.abs(dot(v, this.right)) / side, Math.abs(dot(v, this.up)) / top) - depth;
    }));
  }

  face() {
    const [ca, sa, ch, sh] = [
      Math.cos(this.azimuth), Math.sin(this.azimuth), Math.cos(this.height), Math.sin(this.height),
    ];
    this.forward = [-ch * ca, -ch * sa, -sh];
    this.right = [-sa, ca, 0];
    this.up = [-sh * ca, -sh * sa, ch];
  }

  turn(right, up) {
    this.azimuth += right;
    this.height = Math.min(1.55, Math.max(-1.55, this.height + up));
  }

  zoom(factor) { this.distance = Math.min(1e5, Math.max(0.02, this.distance * factor)); }

  // fixes the view of a canvas of some size [pixel] for the pictures that follow
  look(width, height) {
    this.face();
    this.eye = minus(this.target, this.forward.map((c) => c * this.distance));
    // a narrow picture shows as much to the left and right as a wide one
    this.scale = Math.min(height, width / WIDE) / 2 / Math.tan(VIEW_ANGLE / 2);
    this.middle = [width / 2, height / 2];
  }

  depth(point) { return dot(minus(point, this.eye), this.forward); }

  // pixel of a point, undefined where it is behind the camera or too near
  project(point) {
    const v = minus(point, this.eye);
    const depth = dot(v, this.forward);
    if (depth < NEAR * this.distance) return undefined;
    const s = this.scale / depth;
    return [this.middle[0] + s * dot(v, this.right), this.middle[1] - s * dot(v, this.up), s];
  }
}

// A solid to be drawn: a shape at a pose in the world.
class Solid {
  constructor(shape, pose, place, look) {
    const own = turned(pose.turn, shape.at);
    this.kind = shape.kind;
    this.shape = shape;
    this.shrunk = look.shrink ?? 1;
    this.size = shape.size.map((length) => length * this.shrunk);
    this.turn = shape.matrix ? times(pose.turn, shape.matrix) : pose.turn;
    this.at = plus(plus(pose.at, own), place);
    Object.assign(this, look); // colour, ink, alpha, dash, width, shrink; track, item, name
  }

  get reach() {
    if (this.kind === "box" || this.kind === "faces") return Math.hypot(...this.size) / 2;
    return this.size[0] + (this.size[1] ?? 0) / 2;
  }
}

// Whether a point is in front of a box as the eye sees them: then the box cannot hide it, whatever their depths.
function inFront(box, point, eye) {
  const p = turnedBack(box.turn, minus(point, box.at));
  const e = turnedBack(box.turn, minus(eye, box.at));
  let behind = false;
  for (let axis = 0; axis < 3; axis++) {
    const half = box.size[axis] / 2;
    const side = Math.sign(p[axis]);
    if (side * p[axis] <= half) continue;
    if (side * e[axis] > half) return true;
    behind = true;
  }
  return !behind;
}

// Everything back to front: what stands still by its faces, what moves between it by depth.
function ordered(fixed, moving, camera) {
  const still = [...fixed].sort((a, b) => camera.depth(b.at) - camera.depth(a.at));
  for (let i = 1; i < still.length; i++)
    for (let j = i; j > 0 && still[j].kind === "box" && !inFront(still[j - 1], still[j].at, camera.eye) &&
      inFront(still[j], still[j - 1].at, camera.eye); j--)
      [still[j - 1], still[j]] = [still[j], still[j - 1]];
  const slots = Array.from({ length: still.length + 1 }, () => []);
  for (const solid of moving) {
    let slot = 0;
    still.forEach((box, index) => {
      if (box.kind !== "box" || inFront(box, solid.at, camera.eye)) slot = index + 1;
    });
    slots[slot].push(solid);
  }
  const nearLast = (a, b) => camera.depth(b.at) - camera.depth(a.at);
  return slots.flatMap((slot, index) => [...slot.sort(nearLast), ...(index < still.length ? [still[index]] : [])]);
}

function draw(context, solid, camera) {
  context.globalAlpha = solid.alpha;
  context.setLineDash(solid.dash);
  context.strokeStyle = solid.ink;
  context.lineWidth = solid.width;
  if (solid.kind === "box") box(context, solid, camera);
  else if (solid.kind === "sphere") sphere(context, solid, camera);
  else if (solid.kind === "capsule") capsule(context, solid, camera);
  else if (solid.kind === "faces") faces(context, solid, camera);
  else dot2d(context, solid, camera);
}

function box(context, solid, camera) {
  const half = solid.size.map((edge) => edge / 2);
  const middle = camera.project(solid.at);
  // edges of what is small do not hide its colour
  if (middle) context.lineWidth = Math.min(solid.width, Math.max(0.3, 0.12 * middle[2] * Math.min(...half)));
  const axes = [0, 1, 2].map((a) => [solid.turn[a], solid.turn[3 + a], solid.turn[6 + a]]);
  const toEye = minus(camera.eye, solid.at);
  for (let a = 0; a < 3; a++)
    for (const side of [-1, 1]) {
      const normal = axes[a].map((c) => c * side);
      if (dot(toEye, normal) <= half[a]) continue;
      const [b, c] = [(a + 1) % 3, (a + 2) % 3];
      const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([i, j]) =>
        camera.project(solid.at.map((middle, k) =>
          middle + normal[k] * half[a] + axes[b][k] * i * half[b] + axes[c][k] * j * half[c])));
      if (corners.some((corner) => corner === undefined)) continue;
      context.beginPath();
      corners.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
      context.closePath();
      context.fillStyle = shaded(solid.colour, 0.62 + 0.38 * Math.max(0, dot(normal, LIGHT)));
      context.fill();
      context.stroke();
    }
}

// The faces that look at the eye, the furthest first; their edges have their own colour, so that no gap is between them.
function faces(context, solid, camera) {
  const { points, normals } = solid.shape;
  const places = points.map((point) => plus(solid.at, turned(solid.turn, point.map((c) => c * solid.shrunk))));
  const pixels = places.map((place) => camera.project(place));
  const seen = solid.shape.faces.flatMap((corners, index) => {
    const normal = turned(solid.turn, normals[index]);
    if (corners.some((corner) => !pixels[corner])) return [];
    if (dot(minus(camera.eye, places[corners[0]]), normal) <= 0) return [];
    const near = corners.reduce((sum, corner) => sum + pixels[corner][2], 0) / corners.length;
    return [{ corners, near, light: Math.max(0, dot(normal, LIGHT)) }];
  });
  seen.sort((a, b) => a.near - b.near);
  context.setLineDash([]);
  context.lineWidth = camera.pixel / 2;
  for (const { corners, light } of seen) {
    context.strokeStyle = context.fillStyle = shaded(solid.colour, 0.5 + 0.5 * light);
    context.beginPath();
    corners.forEach((corner, i) => (i ? context.lineTo : context.moveTo).call(context, ...pixels[corner].slice(0, 2)));
    context.closePath();
    context.fill();
    context.stroke();
  }
}

function sphere(context, solid, camera) {
  const middle = camera.project(solid.at);
  if (!middle) return;
  const [x, y, s] = middle;
  const radius = Math.max(1, s * solid.size[0]);
  const glow = context.createRadialGradient(x - radius / 3, y - radius / 3, 0, x, y, radius);
  glow.addColorStop(0, shaded(solid.colour, 1.12));
  glow.addColorStop(1, shaded(solid.colour, 0.62));
  context.fillStyle = glow;
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fill();
  context.stroke();
  context.beginPath(); // a great circle, so that rolling is seen
  let pen = false;
  for (let i = 0; i <= 32; i++) {
    const angle = (i / 32) * 2 * Math.PI;
    const around = turned(solid.turn, [Math.cos(angle) * solid.size[0], 0, Math.sin(angle) * solid.size[0]]);
    const point = plus(solid.at, around);
    const pixel = dot(around, minus(camera.eye, point)) > 0 ? camera.project(point) : undefined;
    if (pixel) pen ? context.lineTo(pixel[0], pixel[1]) : context.moveTo(pixel[0], pixel[1]);
    pen = pixel !== undefined;
  }
  context.stroke();
}

function capsule(context, solid, camera) {
  const reach = turned(solid.turn, [0, 0, solid.size[1] / 2]);
  const [a, b] = [plus(solid.at, reach), minus(solid.at, reach)].map((end) => camera.project(end));
  const middle = camera.project(solid.at);
  if (!a || !b || !middle) return;
  const width = Math.max(2, 2 * middle[2] * solid.size[0]);
  context.lineCap = "round";
  context.setLineDash([]);
  for (const [colour, more, shift] of [[solid.ink, 2 * solid.width, 0], [shaded(solid.colour, 0.8), 0, 0],
    [shaded(solid.colour, 1), -0.45 * width, -0.1 * width]]) {
    context.strokeStyle = colour;
    context.lineWidth = Math.max(1, width + more);
    context.beginPath();
    context.moveTo(a[0] + shift, a[1] + shift);
    context.lineTo(b[0] + shift, b[1] + shift + 0.01); // also where both ends are one pixel
    context.stroke();
  }
  context.lineCap = "butt";
}

function dot2d(context, solid, camera) {
  const middle = camera.project(solid.at);
  if (!middle) return;
  context.fillStyle = shaded(solid.colour, 1);
  context.beginPath();
  context.arc(middle[0], middle[1], 3 * solid.width, 0, 2 * Math.PI);
  context.fill();
}

// Lines on a plane, cut into short ones, so that those behind the camera can be left out.
function grid(context, ground, place, camera, ink) {
  const pose = { at: plus(ground.at, place), turn: ground.matrix ?? matrix(ground.turn) };
  const [half, other] = [ground.size[0] / 2, ground.size[1] / 2];
  const [nx, ny] = [half, other].map((reach) => Math.min(40, Math.round(reach / GRID)));
  context.globalAlpha = 0.5;
  context.setLineDash([]);
  context.strokeStyle = ink;
  context.lineWidth = camera.pixel;
  context.beginPath();
  const line = (from, to) => {
    const ends = [from, to].map(([x, y]) => camera.project(plus(pose.at, turned(pose.turn, [x, y, 0]))));
    if (!ends[0] || !ends[1]) return;
    context.moveTo(ends[0][0], ends[0][1]);
    context.lineTo(ends[1][0], ends[1][1]);
  };
  for (let i = -nx; i <= nx; i++)
    for (let j = -ny; j <= ny; j++) {
      const [x, y] = [i * GRID, j * GRID];
      if (i < nx) line([x, y], [x + GRID, y]);
      if (j < ny) line([x, y], [x, y + GRID]);
    }
  context.stroke();
}

const shades = new Map();

// "#rrggbb" made darker (below 1) or lighter, as far as that goes
function shaded(colour, factor) {
  const key = `${colour} ${factor.toFixed(2)}`;
  let found = shades.get(key);
  if (found === undefined) {
    const parts = /^#(..)(..)(..)$/.exec(colour);
    const numbers = parts ? parts.slice(1).map((two) => parseInt(two, 16)) : [128, 128, 128];
    found = `rgb(${numbers.map((n) => Math.min(255, Math.round(n * factor))).join(" ")})`;
    if (shades.size < 5000) shades.set(key, found);
  }
  return found;
}
