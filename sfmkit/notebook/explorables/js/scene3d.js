// A perspective view of points, lines and areas in 3-D, turned by dragging.
import { apply, cross, dot, minus, plus, times, unit } from "./algebra.js";
import { dragging, html, svg } from "./draw.js";

const [WIDTH, HEIGHT] = [640, 340];

// `target` is the centre of the view and `distance` that of the eye from it.
export function sceneView(orbit, target, distance, turned) {
  const canvas = html("canvas", { width: 2 * WIDTH, height: 2 * HEIGHT });
  const surface = svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "scene" });
  const box = html("div", { class: "stack white" }, canvas, surface);
  let last = null;
  let stale = true;
  dragging(surface, (event, first) => {
    if (event === first) {
      last = [event.clientX, event.clientY];
      return;
    }
    orbit.yaw += 0.4 * (event.clientX - last[0]);
    orbit.pitch = Math.max(-5, Math.min(89, orbit.pitch + 0.4 * (event.clientY - last[1])));
    last = [event.clientX, event.clientY];
    look();
    stale = true;
    turned(event);
  });

  let axes = null; // of the eye; changed by `look`
  function look() {
    const [yaw, pitch] = [orbit.yaw, orbit.pitch].map((v) => (v * Math.PI) / 180);
    const forward = [
      Math.sin(yaw) * Math.cos(pitch), Math.sin(pitch), Math.cos(yaw) * Math.cos(pitch),
    ]; // y points down
    const right = unit(cross([0, 1, 0], forward));
    axes = [right, cross(forward, right), forward];
  }
  look();

  // Screen position and depth of a point; null behind the eye.
  function place(X) {
    const [x, y, z] = apply(axes, minus(X, target));
    const depth = z + distance;
    if (depth < 0.02 * distance) return null;
    const s = (1.3 * HEIGHT) / depth;
    return [WIDTH / 2 + s * x, HEIGHT / 2 + s * y, depth];
  }

  // Screen positions of a line or area; null if a part is behind the eye.
  const placeAll = (list) => {
    const placed = list.map(place);
    return placed.every((p) => p !== null) ? placed : null;
  };

  // The point of the screen position on the plane with y = height.
  function onGround([u, v], height) {
    const [right, down, forward] = axes;
    const s = 1.3 * HEIGHT;
    const ray = plus(
      plus(times(right, (u - WIDTH / 2) / s), times(down, (v - HEIGHT / 2) / s)), forward,
    );
    const eye = minus(target, times(forward, distance));
    const depth = (height - eye[1]) / ray[1];
    return depth > 0 ? plus(eye, times(ray, depth)) : null;
  }

  // Draw the points, if the eye has moved since they were drawn.
  function dots(list, colours) {
    if (!stale) return;
    stale = false;
    const context = canvas.getContext("2d");
    context.clearRect(0, 0, canvas.width, canvas.height);
    list.forEach((X, k) => {
      const p = place(X);
      if (p === null) return;
      context.fillStyle = colours[k];
      context.fillRect(2 * p[0] - 2, 2 * p[1] - 2, 4, 4);
    });
  }

  return { box, surface, place, placeAll, onGround, dots };
}

// The corners of an image plane at a depth, and the map from pixels to points on it.
export function frustum(K, R, t, [w, h], depth) {
  const centre = R.map((_, k) => -dot(R.map((row) => row[k]), t));
  const onPlane = ([x, y]) => {
    const ray = [(x - K[0][2]) / K[0][0], (y - K[1][2]) / K[1][1], 1].map((v) => v * depth);
    return plus(centre, [0, 1, 2].map((k) => dot(R.map((row) => row[k]), ray)));
  };
  const corners = [[-0.5, -0.5], [w - 0.5, -0.5], [w - 0.5, h - 0.5], [-0.5, h - 0.5]].map(onPlane);
  return { centre, onPlane, corners };
}
