"use strict";
// A small 3D view on a plain canvas: points and boxes of one frame, turned by pointer, touch or keyboard.
(() => {
  const canvas = document.getElementById("scene");
  if (!canvas) return;
  const context = canvas.getContext("2d", { alpha: false });
  const data = canvas.dataset;
  const frames = JSON.parse(data.frames);
  const slider = document.getElementById("at");
  const play = document.getElementById("play");
  const note = document.getElementById("scene-note");
  const view = { yaw: Math.PI, pitch: 0.55, distance: 32, target: [0, 0, 0] };
  const cache = new Map();
  const ofTrack = Number(data.track) >= 0 ? `&track=${data.track}` : "";
  let scene = null, wanted = Number(data.frame), timer = 0, aimed = false;

  const nearest = (frame) => frames.reduce((best, one) => (Math.abs(one - frame) < Math.abs(best - frame) ? one : best));
  const isHit = (box, index) =>
    Number(data.track) >= 0 ? box.track === Number(data.track) : scene.frame === Number(data.hitFrame) && index === Number(data.box);

  async function load(frame) {
    if (cache.has(frame)) return cache.get(frame);
    const place = `${data.source}/${data.segment}/${frame}`;
    const [boxes, points] = await Promise.all([
      fetch(`/api/boxes/${place}?v=${data.version}${ofTrack}`),
      fetch(`/api/points/${place}?v=${data.version}`).catch(() => null),
    ]);
    if (!boxes.ok) throw new Error(await boxes.text());
    const loaded = await boxes.json();
    loaded.points = points && points.ok ? new Int16Array(await points.arrayBuffer()) : new Int16Array(0);
    loaded.note = points && points.ok ? "" : "The sweep cannot be read: boxes alone are shown.";
    cache.set(frame, loaded);
    if (cache.size > 40) cache.delete(cache.keys().next().value);
    return loaded;
  }

  async function show(frame) {
    wanted = frame;
    let loaded;
    try {
      loaded = await load(frame);
    } catch (error) {
      note.textContent = `The frame cannot be shown: ${error.message}`;
      return;
    }
    if (wanted !== frame) return;
    scene = loaded;
    note.textContent = loaded.note;
    const hit = loaded.boxes.find(isHit);
    if (hit && !aimed) {
      aimed = true;
      // Look at the hit from the side of the car, as its sensor does.
      view.yaw = Math.atan2(-hit.center[1], -hit.center[0]) + 0.5;
      view.distance = Math.max(12, 4 * Math.hypot(...hit.size));
    }
    if (hit) view.target = hit.center;
    document.getElementById("frame-name").textContent = frame;
    document.getElementById("frame-time").textContent = loaded.time_s === null ? "" : `${loaded.time_s.toFixed(1)} s`;
    canvas.dataset.shown = frame;
    cameras(loaded);
    draw();
  }

  function cameras(loaded) {
    const list = document.getElementById("cameras");
    const figures = new Map([...list.children].map((figure) => [Number(figure.dataset.camera), figure]));
    let seen = false;
    for (const camera of loaded.cameras) {
      const figure = figures.get(camera.number);
      if (!figure) continue;
      figure.classList.toggle("unseen", !camera.sees);
      seen = seen || camera.sees;
      const image = figure.querySelector("img");
      const address = `/camera/${data.source}/${data.segment}/${loaded.frame}/${camera.number}?v=${data.version}${ofTrack}`;
      if (!timer && image.getAttribute("src") !== address) image.src = address;
    }
    document.getElementById("unseen").hidden = seen || !loaded.cameras.length;
  }

  function camera() {
    const cp = Math.cos(view.pitch), sp = Math.sin(view.pitch), cy = Math.cos(view.yaw), sy = Math.sin(view.yaw);
    const eye = [view.target[0] + view.distance * cp * cy, view.target[1] + view.distance * cp * sy, view.target[2] + view.distance * sp];
    const focal = canvas.width * 0.8;
    // Rows: to the right, downwards, along the view.
    return { eye, focal, right: [-sy, cy, 0], down: [sp * cy, sp * sy, -cp], along: [-cp * cy, -cp * sy, -sp] };
  }

  function project(from, x, y, z) {
    const dx = x - from.eye[0], dy = y - from.eye[1], dz = z - from.eye[2];
    const depth = dx * from.along[0] + dy * from.along[1] + dz * from.along[2];
    if (depth < 0.3) return null;
    const scale = from.focal / depth;
    return [
      canvas.width / 2 + scale * (dx * from.right[0] + dy * from.right[1]),
      canvas.height / 2 + scale * (dx * from.down[0] + dy * from.down[1] + dz * from.down[2]),
      depth,
    ];
  }

  function draw() {
    if (!scene) return;
    const from = camera();
    drawPoints(from);
    drawCar(from);
    scene.boxes.forEach((box, index) => drawBox(from, box, isHit(box, index)));
  }

  function drawPoints(from) {
    const width = canvas.width, height = canvas.height;
    const image = context.createImageData(width, height);
    const pixels = new Uint32Array(image.data.buffer).fill(0xff1a1412);
    const hit = scene.boxes.find(isHit);
    const c = hit ? Math.cos(hit.heading) : 1, s = hit ? Math.sin(hit.heading) : 0;
    for (let place = 0; place + 2 < scene.points.length; place += 3) {
      const x = scene.points[place] / 100, y = scene.points[place + 1] / 100, z = scene.points[place + 2] / 100;
      const pixel = project(from, x, y, z);
      if (!pixel) continue;
      const u = pixel[0] | 0, v = pixel[1] | 0;
      const wide = pixel[2] < 30 ? 3 : 2;
      if (u < 0 || v < 0 || u >= width - wide || v >= height - wide) continue;
      let colour = height_colour(z);
      if (hit) {
        const dx = x - hit.center[0], dy = y - hit.center[1], dz = z - hit.center[2];
        const inside = Math.abs(dx * c + dy * s) <= hit.size[0] / 2 && Math.abs(dy * c - dx * s) <= hit.size[1] / 2 && Math.abs(dz) <= hit.size[2] / 2;
        if (inside) colour = 0xff308aff;
      }
      for (let row = v; row < v + wide; row++) pixels.fill(colour, row * width + u, row * width + u + wide);
    }
    context.putImageData(image, 0, 0);
  }

  function height_colour(z) {
    const share = Math.min(Math.max((z + 2.5) / 6, 0), 1);
    return (0xff << 24 | (170 + 80 * share) << 16 | (130 + 115 * share) << 8 | (110 + 80 * share)) >>> 0;
  }

  function drawCar(from) {
    line(from, [[-1, 0, 0], [2, 0, 0]], "#e6e9ee", 2);
    line(from, [[0, -1, 0], [0, 1, 0]], "#e6e9ee", 2);
  }

  function line(from, places, colour, width) {
    context.beginPath();
    let open = false;
    for (const place of places) {
      const pixel = project(from, ...place);
      if (pixel) open ? context.lineTo(pixel[0], pixel[1]) : context.moveTo(pixel[0], pixel[1]);
      open = Boolean(pixel);
    }
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.stroke();
  }

  function drawBox(from, box, chosen) {
    const c = Math.cos(box.heading), s = Math.sin(box.heading);
    const [l, w, h] = box.size.map((side) => side / 2);
    const corner = (a, b, e) => [box.center[0] + a * l * c - b * w * s, box.center[1] + a * l * s + b * w * c, box.center[2] + e * h];
    const colour = chosen ? "#ff8a30" : "#6ea3f2", width = chosen ? 3 : 1.2;
    const turns = [[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]];
    for (const level of [-1, 1]) line(from, turns.map(([a, b]) => corner(a, b, level)), colour, width);
    for (const [a, b] of turns.slice(0, 4)) line(from, [corner(a, b, -1), corner(a, b, 1)], colour, width);
    // From the centre to the front: where it heads.
    line(from, [corner(0, 0, -1), corner(1.4, 0, -1)], colour, width);
    if (chosen) {
      const top = project(from, ...corner(0, 0, 1.6));
      if (!top) return;
      context.fillStyle = "#ffb27a";
      context.font = "20px system-ui, sans-serif";
      context.textAlign = "center";
      context.fillText(`${box.name || "object"} ${box.speed.toFixed(1)} m/s`, top[0], top[1]);
    }
  }

  const turn = (yaw, pitch) => {
    view.yaw += yaw;
    view.pitch = Math.min(Math.max(view.pitch + pitch, 0.05), 1.5);
    draw();
  };
  const zoom = (factor) => {
    view.distance = Math.min(Math.max(view.distance * factor, 3), 200);
    draw();
  };
  const pointers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, event);
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const spread = () => {
      const [a, b] = [...pointers.values()];
      return Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
    };
    const old = pointers.size === 2 ? spread() : 0;
    pointers.set(event.pointerId, event);
    if (pointers.size === 2) zoom(old / Math.max(spread(), 1));
    else turn((before.clientX - event.clientX) * 0.008, (event.clientY - before.clientY) * 0.006);
  });
  for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, (event) => pointers.delete(event.pointerId));
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(event.deltaY * 0.001));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const keys = {
      ArrowLeft: () => turn(0.12, 0), ArrowRight: () => turn(-0.12, 0), ArrowUp: () => turn(0, 0.08), ArrowDown: () => turn(0, -0.08),
      "+": () => zoom(0.85), "=": () => zoom(0.85), "-": () => zoom(1.18), 0: () => { aimed = false; show(wanted); },
    };
    if (!keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
  });

  let pending = 0;
  slider.addEventListener("input", () => {
    clearTimeout(pending);
    pending = setTimeout(() => show(nearest(Number(slider.value))), 60);
  });
  slider.form.addEventListener("submit", (event) => {
    event.preventDefault();
    show(nearest(Number(slider.value)));
  });
  play.hidden = false;
  play.addEventListener("click", () => {
    if (timer) {
      clearInterval(timer);
      timer = 0;
      play.textContent = "Play";
      show(wanted);
      return;
    }
    play.textContent = "Pause";
    let busy = false;
    timer = setInterval(async () => {
      if (busy) return;
      busy = true;
      const place = frames.indexOf(wanted);
      const next = frames[(place + 1) % frames.length];
      slider.value = next;
      await show(next);
      busy = false;
    }, 150);
  });
  show(nearest(wanted));
})();
