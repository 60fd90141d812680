// The 3-D view of a report page: cameras, points and ellipsoids, drawn by three.js.
const scene3d = JSON.parse(document.getElementById("data").textContent).scene;
const place = document.querySelector(".scene");

function floats(text) {
  return new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
}

function colour(name) {
  return new THREE.Color(getComputedStyle(document.body).getPropertyValue(name).trim());
}

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

  const positions = floats(scene3d.points), errors = floats(scene3d.errors);
  const cloud = new THREE.BufferGeometry();
  cloud.setAttribute("position", new THREE.BufferAttribute(positions, 3));
  cloud.setAttribute("color", new THREE.BufferAttribute(new Float32Array(positions.length), 3));
  const points = new THREE.Points(cloud, new THREE.PointsMaterial({
    size: 2, sizeAttenuation: false, vertexColors: true,
  }));
  const poses = new THREE.BufferGeometry();
  poses.setAttribute("position", new THREE.BufferAttribute(
    frustums(floats(scene3d.centers), floats(scene3d.axes), floats(scene3d.fields), scene3d.frustum), 3));
  const cameras = new THREE.LineSegments(poses, new THREE.LineBasicMaterial());
  points.frustumCulled = cameras.frustumCulled = false;
  const balls = new THREE.Group();
  for (const [kind, name] of [["point_ellipsoids", "--c1"], ["camera_ellipsoids", "--c2"]]) {
    if (scene3d[kind]) balls.add(ellipsoids(scene3d[kind], name));
  }
  world.add(points, cameras, balls);

  function draw() {
    renderer.render(world, camera);
    place.dataset.drawn = String(Number(place.dataset.drawn || 0) + 1);
  }

  function paint() {
    renderer.setClearColor(colour("--paper"));
    cameras.material.color = colour("--ink");
    const good = colour("--c0"), bad = colour("--c1"), none = colour("--rest");
    const mixed = new THREE.Color(), colours = cloud.getAttribute("color");
    for (let i = 0; i < errors.length; i += 1) {
      if (Number.isNaN(errors[i])) mixed.copy(none);
      else mixed.copy(good).lerp(bad, Math.min(errors[i] / scene3d.error_limit, 1));
      colours.setXYZ(i, mixed.r, mixed.g, mixed.b);
    }
    colours.needsUpdate = true;
    balls.children.forEach((mesh) => { mesh.material.color = colour(mesh.userData.colour); });
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

  function home() {
    const up = new THREE.Vector3(...scene3d.up), forward = new THREE.Vector3(...scene3d.forward);
    const side = new THREE.Vector3().crossVectors(forward, up);
    const eye = side.multiplyScalar(0.6).addScaledVector(up, 0.55).addScaledVector(forward, -0.75);
    controls.target.set(...scene3d.middle);
    camera.position.copy(controls.target).addScaledVector(eye.normalize(), 2.7 * scene3d.reach);
    controls.update();
    draw();
  }

  const shown = { points, cameras, ellipsoids: balls };
  document.querySelectorAll("[data-shows]").forEach((box) => {
    box.addEventListener("change", () => { shown[box.dataset.shows].visible = box.checked; draw(); });
  });
  document.getElementById("point-size").addEventListener("input", (event) => {
    points.material.size = Number(event.target.value);
    draw();
  });
  document.getElementById("scene-home").addEventListener("click", home);
  controls.addEventListener("change", draw);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", paint);
  new ResizeObserver(fit).observe(place);
  fit();
  home();
  paint();
}

if (document.createElement("canvas").getContext("webgl2")) start();
else place.querySelector("p").hidden = false;
