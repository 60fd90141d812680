// The 3-D view of a report page, drawn by three.js, and the dialog with the residuals of an image.
const data = JSON.parse(document.getElementById("data").textContent);
const scene3d = data.scene, images = data.images || [];
const find = (name) => document.getElementById(name);
const place = document.querySelector(".scene"), dialog = document.querySelector("dialog");

function bytes(text) {
  return Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
}

function floats(text) {
  return new Float32Array(bytes(text).buffer);
}

function colour(name) {
  return new THREE.Color(getComputedStyle(document.body).getPropertyValue(name).trim());
}

// An image: its photograph, and lines from the measurements to the projections.
let current = 0;

function facts(image) {
  const sigma = image.sigma === null ? "" : `, position sigma ${image.sigma.toPrecision(3)}`;
  return `${image.name}: RMSE ${image.rmse.toPrecision(3)} px, ${image.count} observations${sigma}`;
}

function showImage(index) {
  current = (index + images.length) % images.length;
  const image = images[current], [left, top, right, bottom] = image.box;
  const figure = [...document.querySelectorAll("svg.photographed")].find((one) => one.ariaLabel === image.figure);
  const photograph = image.photograph || (figure && figure.querySelector("image").getAttribute("href"));
  const svg = (name, attributes) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    Object.entries(attributes).forEach(([key, value]) => made.setAttribute(key, value));
    return made;
  };
  const area = { x: left, y: top, width: right - left, height: bottom - top };
  const drawing = svg("svg", { viewBox: Object.values(area).join(" "), role: "img", "aria-label": image.name });
  drawing.append(svg("rect", { ...area, class: "plane" }));
  if (photograph) {
    drawing.classList.add("photographed");
    drawing.append(svg("image", { ...area, href: photograph, preserveAspectRatio: "none" }));
  }
  let path = "";
  for (let k = 0; k < image.vectors.length; k += 4) {
    const [x, y, dx, dy] = image.vectors.slice(k, k + 4);
    path += `M${x} ${y}l${image.factor * dx} ${image.factor * dy}`;
  }
  for (const kind of ["casing", "residuals"]) {
    if (photograph || kind === "residuals") drawing.append(svg("path", { d: path, class: kind }));
  }
  find("image-name").textContent = `${facts(image)}; residuals ${image.factor} times as long`;
  find("photograph").replaceChildren(drawing);
  if (!dialog.open) dialog.showModal();
}

find("image").append(new Option("Image …", ""), ...images.map((image, k) => new Option(image.name, k)));
find("image").hidden = images.length === 0;
find("image").addEventListener("change", (event) => {
  if (event.target.value) showImage(Number(event.target.value));
  event.target.value = "";
});
dialog.querySelectorAll("[data-step]").forEach((button) => {
  button.addEventListener("click", () => showImage(current + Number(button.dataset.step)));
});
find("close").addEventListener("click", () => dialog.close());
find("scene-full").addEventListener("click", () => {
  if (document.fullscreenElement) document.exitFullscreen();
  else document.querySelector(".view").requestFullscreen();
});

// Four edges from the centre of each camera to the corners of its image, and the image's border.
function frustums(centers, axes, fields, size) {
  const lines = [];
  for (let i = 0; 3 * i < centers.length; i += 1) {
    const corner = (x, y) => [0, 1, 2].map((k) =>
      centers[3 * i + k] + size * (x * fields[2 * i] * axes[9 * i + k] +
        y * fields[2 * i + 1] * axes[9 * i + 3 + k] + axes[9 * i + 6 + k]));
    const center = [0, 1, 2].map((k) => centers[3 * i + k]);
    const corners = [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)];
    corners.forEach((from, k) => {
      lines.push(...center, ...from, ...from, ...corners[(k + 1) % 4]);
    });
  }
  return new Float32Array(lines);
}

function ellipsoids(given, name) {
  const positions = floats(given.positions), axes = floats(given.axes);
  const count = positions.length / 3;
  const material = new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.35, depthWrite: false });
  const mesh = new THREE.InstancedMesh(new THREE.SphereGeometry(1, 16, 10), material, count);
  const matrix = new THREE.Matrix4();
  for (let i = 0; i < count; i += 1) {
    const a = axes.subarray(9 * i, 9 * i + 9), p = positions.subarray(3 * i, 3 * i + 3);
    // Columns are the half axes.
    matrix.set(a[0], a[3], a[6], p[0], a[1], a[4], a[7], p[1], a[2], a[5], a[8], p[2], 0, 0, 0, 1);
    mesh.setMatrixAt(i, matrix);
  }
  mesh.frustumCulled = false;
  mesh.userData.colour = name;
  return mesh;
}

function start() {
  const canvas = place.querySelector("canvas");
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
  const world = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(45, 1, 0.002, 400);
  camera.up.set(...scene3d.up);
  const controls = new OrbitControls(camera, canvas);
  controls.listenToKeyEvents(canvas);

  const fields = floats(scene3d.fields);
  const states = {};
  for (const name of ["before", "after"]) {
    const given = scene3d[name];
    if (!given) continue;
    const centers = floats(given.centers);
    states[name] = {
      points: floats(given.points), centers, error: given.error,
      lines: frustums(centers, floats(given.axes), fields, scene3d.frustum),
    };
  }
  let state = states.after;
  const buffer = (values) => new THREE.BufferAttribute(values.slice(), 3);
  const cloud = new THREE.BufferGeometry(), poses = new THREE.BufferGeometry();
  cloud.setAttribute("position", buffer(state.points));
  cloud.setAttribute("color", buffer(state.points));
  poses.setAttribute("position", buffer(state.lines));
  const points = new THREE.Points(cloud, new THREE.PointsMaterial({
    size: 2, sizeAttenuation: false, vertexColors: true,
  }));
  const cameras = new THREE.LineSegments(poses, new THREE.LineBasicMaterial());
  points.frustumCulled = cameras.frustumCulled = false;
  const balls = new THREE.Group();
  for (const [kind, name] of [["point_ellipsoids", "--c1"], ["camera_ellipsoids", "--c2"]]) {
    if (scene3d[kind]) balls.add(ellipsoids(scene3d[kind], name));
  }
  const afterOnly = new THREE.Group();
  afterOnly.add(balls);
  // Edges of a graph, between points.
  const edges = new THREE.Group(), links = [];
  for (const [kind, name] of [["path", "--c0"], ["others", "--c2"]]) {
    const pairs = scene3d.edges ? floats(scene3d.edges[kind]) : [];
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * pairs.length), 3));
    const lines = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial());
    lines.frustumCulled = false;
    lines.userData.colour = name;
    edges.add(lines);
    links.push([geometry.getAttribute("position"), pairs]);
  }
  function join() {
    for (const [position, pairs] of links) {
      pairs.forEach((at, k) => position.setXYZ(k, ...state.points.subarray(3 * at, 3 * at + 3)));
      position.needsUpdate = true;
    }
  }
  join();
  world.add(points, cameras, edges, afterOnly);

  const chooser = find("shade");
  chooser.append(...[state.error, ...scene3d.shades].map((one, k) => new Option(`colour: ${one.name}`, k)));

  // Once for all changes before the next frame: without a graphics card a drawing takes long.
  let waits = false;
  function draw() {
    if (waits) return;
    waits = true;
    requestAnimationFrame(() => {
      waits = false;
      renderer.render(world, camera);
      place.dataset.drawn = String(Number(place.dataset.drawn || 0) + 1);
    });
  }

  function paint() {
    renderer.setClearColor(colour("--paper"));
    cameras.material.color = colour("--ink");
    const chosen = [state.error, ...scene3d.shades][Number(chooser.value)];
    const shades = bytes(chosen.shades), colours = cloud.getAttribute("color");
    const good = colour("--c0"), bad = colour("--c1"), none = colour("--rest");
    const mixed = new THREE.Color();
    for (let i = 0; i < shades.length; i += 1) {
      if (shades[i] === 255) mixed.copy(none);
      else mixed.copy(good).lerp(bad, shades[i] / 254);
      colours.setXYZ(i, mixed.r, mixed.g, mixed.b);
    }
    colours.needsUpdate = true;
    edges.children.forEach((lines) => { lines.material.color = colour(lines.userData.colour); });
    balls.children.forEach((mesh) => { mesh.material.color = colour(mesh.userData.colour); });
    find("legend").textContent = `Blue: ${chosen.ends[0]}; orange: ${chosen.ends[1]}; grey: unknown.`;
    draw();
  }

  function fit() {
    const width = place.clientWidth, height = place.clientHeight;
    renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    renderer.setSize(width, height, false);
    camera.aspect = width / Math.max(height, 1);
    camera.updateProjectionMatrix();
    draw();
  }

  function inView(centers) {
    const at = new THREE.Vector3();
    for (let i = 0; i < centers.length; i += 3) {
      at.fromArray(centers, i).project(camera);
      if (!(Math.abs(at.x) < 0.95 && Math.abs(at.y) < 0.95 && at.z < 1)) return false;
    }
    return true;
  }

  function home() {
    const up = new THREE.Vector3(...scene3d.up), forward = new THREE.Vector3(...scene3d.forward);
    const side = new THREE.Vector3().crossVectors(forward, up);
    const eye = side.multiplyScalar(0.6).addScaledVector(up, 0.55).addScaledVector(forward, -0.75);
    controls.target.set(...scene3d.middle);
    eye.normalize();
    // Far enough that the view has every camera.
    for (let away = 2.7 * scene3d.reach, k = 0; k < 30; away *= 1.1, k += 1) {
      camera.position.copy(controls.target).addScaledVector(eye, away);
      controls.update();
      camera.updateMatrixWorld();
      if (inView(states.after.centers)) break;
    }
    draw();
  }

  // The image whose camera is nearest to the mouse pointer, within 16 pixels; undefined: none.
  function pointed(event) {
    if (!cameras.visible) return undefined;
    const box = canvas.getBoundingClientRect(), at = new THREE.Vector3();
    let nearest = 16, found;
    scene3d.images.forEach((id, i) => {
      at.fromArray(state.centers, 3 * i).project(camera);
      const x = box.left + (at.x + 1) / 2 * box.width, y = box.top + (1 - at.y) / 2 * box.height;
      const away = Math.hypot(x - event.clientX, y - event.clientY);
      if (at.z < 1 && away < nearest) [nearest, found] = [away, images.findIndex((one) => one.id === id)];
    });
    return found === -1 ? undefined : found;
  }

  const down = [0, 0];
  canvas.addEventListener("pointerdown", (event) => { down.splice(0, 2, event.clientX, event.clientY); });
  canvas.addEventListener("pointerup", (event) => {
    if (Math.hypot(event.clientX - down[0], event.clientY - down[1]) > 4) return;
    const image = pointed(event);
    if (image !== undefined) showImage(image);
  });
  canvas.addEventListener("pointermove", (event) => {
    const image = event.buttons ? undefined : pointed(event);
    find("hover").textContent = image === undefined ? "" : facts(images[image]);
    canvas.style.cursor = image === undefined ? "" : "pointer";
  });

  const shown = { points, cameras, edges, ellipsoids: balls };
  document.querySelectorAll("[data-shows]").forEach((box) => {
    box.addEventListener("change", () => { shown[box.dataset.shows].visible = box.checked; draw(); });
  });
  const buttons = document.querySelectorAll("[data-state]");
  buttons.forEach((button) => {
    button.addEventListener("click", () => {
      state = states[button.dataset.state];
      buttons.forEach((one) => one.setAttribute("aria-pressed", String(one === button)));
      for (const [geometry, values] of [[cloud, state.points], [poses, state.lines]]) {
        geometry.getAttribute("position").copyArray(values);
        geometry.getAttribute("position").needsUpdate = true;
      }
      join();
      afterOnly.visible = state === states.after;
      paint();
    });
  });
  chooser.addEventListener("change", paint);
  find("point-size").addEventListener("input", (event) => {
    points.material.size = Number(event.target.value);
    draw();
  });
  find("scene-home").addEventListener("click", home);
  controls.addEventListener("change", draw);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paint);
  new ResizeObserver(fit).observe(place);
  fit();
  home();
  paint();
}

if (document.createElement("canvas").getContext("webgl2")) start();
else find("sorry").hidden = false;
