// Turns a fitted object: measured points on the left, the simulated surface on the right.
"use strict";
(() => {
  const data = JSON.parse(document.getElementById("scene").textContent);
  const root = document.getElementById("viewer");
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  // Arrays are whole numbers of a unit; the smallest number stands for "not known".
  const numbers = (packed) => {
    const found = Float32Array.from(new Int16Array(bytes(packed.data)));
    return found.map((x) => (x === -32768 ? NaN : x * packed.unit));
  };
  const vertices = numbers(data.vertices);
  const triangles = new Uint32Array(bytes(data.triangles));
  const held = new Uint8Array(bytes(data.held));
  const probings = data.probings.map((one) => ({
    ...one,
    points: numbers(one.points), normals: numbers(one.normals), measured: numbers(one.measured),
    predicted: numbers(one.predicted), sigmas: numbers(one.sigmas),
    surface: one.surface && numbers(one.surface),
  }));
  const colours = data.colours.map((c) => [1, 3, 5].map((k) => parseInt(c.slice(k, k + 2), 16)));
  const view = { azimuth: -0.9, elevation: 0.55, zoom: 1 };
  const state = { probing: 0, mode: "displacement", factor: 1 };
  const length = (a, k) => Math.hypot(a[3 * k], a[3 * k + 1], a[3 * k + 2]);

  const SURFACE = [
    `attribute vec3 place, moved; attribute float value, kept;
     uniform mat4 camera; uniform float factor; varying float v, f; varying vec3 eye;
     void main() { vec4 p = camera * vec4(place + factor * moved, 1.0);
       eye = p.xyz; v = value; f = kept; gl_Position = p; }`,
    `#extension GL_OES_standard_derivatives : enable
     precision highp float; uniform sampler2D map; uniform float painted;
     varying float v, f; varying vec3 eye;
     void main() {
       vec3 n = normalize(cross(dFdx(eye), dFdy(eye)));
       if (n.z > 0.0) n = -n;
       float light = 0.62 + 0.38 * clamp(dot(n, normalize(vec3(0.45, -0.5, -0.75))), 0.0, 1.0);
       vec3 body = vec3(0.90, 0.91, 0.92);
       if (painted > 0.5) {
         float band = 10.0 * clamp(v, 0.0, 1.0);
         body = texture2D(map, vec2((floor(band) + 0.5) / 10.0, 0.5)).rgb;
         float edge = abs(fract(band + 0.5) - 0.5) / max(fwidth(band), 1e-6);
         if (edge < 0.7 && band > 0.5 && band < 9.9) body *= 0.55;
       }
       if (f > 0.5) {
         float stripe = fract((gl_FragCoord.x + gl_FragCoord.y) / 9.0);
         body = mix(body, stripe < 0.3 ? vec3(0.22, 0.25, 0.30) : vec3(0.80), 0.75);
       }
       gl_FragColor = vec4(body * light, 1.0); }`,
  ];
  const POINTS = [
    // A point is seen where the surface under it is: moved ones would dive into the body.
    `attribute vec3 place, moved, normal; attribute float value;
     uniform mat4 camera; uniform float factor, size, grow; varying float v;
     void main() { vec4 rest = camera * vec4(place, 1.0);
       vec4 p = camera * vec4(place + factor * moved, 1.0);
       bool away = (camera * vec4(normal, 0.0)).z > -0.0005;
       gl_Position = away ? vec4(2.0, 2.0, 2.0, 1.0) : vec4(p.xy, rest.z - 0.15, 1.0); v = value;
       gl_PointSize = size * (1.0 + grow * clamp(value, 0.0, 1.0)); }`,
    `precision highp float; uniform sampler2D map; uniform float line; varying float v;
     void main() {
       float r = length(gl_PointCoord - 0.5);
       if (line < 0.5 && r > 0.5) discard;
       vec3 body = texture2D(map, vec2((floor(min(10.0 * clamp(v, 0.0, 1.0), 9.9)) + 0.5) / 10.0, 0.5)).rgb;
       gl_FragColor = vec4(line > 0.5 || r > 0.38 ? vec3(0.11, 0.12, 0.14) : body, 1.0); }`,
  ];

  class Picture {
    constructor(box, kind) {
      this.kind = kind;
      // What WebGL draws is copied to a plain picture: browsers print that one.
      this.canvas = document.createElement("canvas");
      this.cover = document.createElement("canvas");
      box.append(this.cover);
      this.pen = this.cover.getContext("2d");
      const gl = this.canvas.getContext("webgl", { antialias: true });
      if (!gl) throw new Error("no WebGL");
      gl.getExtension("OES_standard_derivatives");
      this.gl = gl;
      this.programs = [SURFACE, POINTS].map((source) => this.program(source));
      const map = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, map);
      const texels = Uint8Array.from(colours.flatMap((c) => [...c, 255]));
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, colours.length, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, texels);
      for (const [name, value] of [["MIN_FILTER", "NEAREST"], ["MAG_FILTER", "NEAREST"],
        ["WRAP_S", "CLAMP_TO_EDGE"], ["WRAP_T", "CLAMP_TO_EDGE"]])
        gl.texParameteri(gl.TEXTURE_2D, gl["TEXTURE_" + name], gl[value]);
      this.buffers = {};
      this.put("place", this.corners(vertices, 3), 3);
      this.put("kept", Float32Array.from(triangles, (_, k) => held[Math.floor(k / 3)]), 1);
    }
    program([vertex, fragment]) {
      const gl = this.gl, program = gl.createProgram();
      for (const [type, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
        const shader = gl.createShader(type);
        gl.shaderSource(shader, text);
        gl.compileShader(shader);
        if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
        gl.attachShader(program, shader);
      }
      gl.linkProgram(program);
      return program;
    }
    corners(array, width) {
      const found = new Float32Array(width * triangles.length);
      triangles.forEach((vertex, k) => {
        for (let c = 0; c < width; c++) found[width * k + c] = array[width * vertex + c];
      });
      return found;
    }
    put(name, array, width) {
      const gl = this.gl;
      this.buffers[name] ??= { buffer: gl.createBuffer(), width };
      gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[name].buffer);
      gl.bufferData(gl.ARRAY_BUFFER, array, gl.STATIC_DRAW);
      this.buffers[name].count = array.length / width;
    }
    load(probing, top) {
      const shown = probing.surface ?? new Float32Array(vertices.length);
      const values = Float32Array.from({ length: vertices.length / 3 }, (_, k) => length(shown, k) / top);
      this.put("moved", this.corners(shown, 3), 3);
      this.put("value", this.corners(values, 1), 1);
      const sigmas = state.mode === "residuals";
      const known = [];
      for (let k = 0; k < probing.sigmas.length; k++)
        if (Number.isFinite(probing.measured[3 * k])) known.push(k);
      this.known = known;
      const spread = (array) => Float32Array.from(known.flatMap((k) => [0, 1, 2].map((c) => array[3 * k + c])));
      this.put("p_place", spread(probing.points), 3);
      this.put("p_moved", spread(probing.measured), 3);
      this.put("p_normal", spread(probing.normals), 3);
      this.put("l_normal", Float32Array.from(known.flatMap((k) => [0, 1].flatMap(() =>
        [0, 1, 2].map((c) => probing.normals[3 * k + c])))), 3);
      this.put("p_value", Float32Array.from(known, (k) =>
        sigmas ? Math.min(probing.sigmas[k] / data.most_sigmas, 1) : length(probing.measured, k) / top), 1);
      const ends = known.flatMap((k) => [0, 1, 2].map((c) => probing.points[3 * k + c]));
      this.put("l_place", Float32Array.from(known.flatMap((_, i) =>
        [...ends.slice(3 * i, 3 * i + 3), ...ends.slice(3 * i, 3 * i + 3)])), 3);
      this.put("l_moved", Float32Array.from(known.flatMap((k) =>
        [0, 0, 0, ...[0, 1, 2].map((c) => probing.measured[3 * k + c])])), 3);
      this.put("l_value", new Float32Array(2 * known.length), 1);
    }
    use(program, names, uniforms) {
      const gl = this.gl;
      gl.useProgram(program);
      for (const [attribute, name] of Object.entries(names)) {
        const place = gl.getAttribLocation(program, attribute);
        if (place < 0) continue;
        gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[name].buffer);
        gl.enableVertexAttribArray(place);
        gl.vertexAttribPointer(place, this.buffers[name].width, gl.FLOAT, false, 0, 0);
      }
      for (const [name, value] of Object.entries(uniforms)) {
        const place = gl.getUniformLocation(program, name);
        if (typeof value === "number") gl.uniform1f(place, value);
        else gl.uniformMatrix4fv(place, false, value);
      }
    }
    draw() {
      const gl = this.gl, ratio = Math.min(window.devicePixelRatio || 1, 2);
      const { clientWidth: w, clientHeight: h } = this.cover;
      if (!w || !h) return;
      for (const canvas of [this.canvas, this.cover])
        if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio))
          [canvas.width, canvas.height] = [Math.round(w * ratio), Math.round(h * ratio)];
      gl.viewport(0, 0, this.canvas.width, this.canvas.height);
      gl.clearColor(1, 1, 1, 1);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.enable(gl.DEPTH_TEST);
      const camera = this.camera(w, h), residuals = state.mode === "residuals";
      const simulated = this.kind === "simulated";
      this.use(this.programs[0],
        { place: "place", moved: "moved", value: "value", kept: "kept" },
        { camera, factor: simulated ? state.factor : 0, painted: simulated ? 1 : 0 });
      gl.drawArrays(gl.TRIANGLES, 0, this.buffers.place.count);
      if (!simulated) {
        const factor = residuals ? 0 : state.factor;
        const common = { camera, factor, grow: residuals ? 1 : 0 };
        const size = ratio * Math.max(5, Math.min(13, 170 / Math.sqrt(this.known.length + 1)));
        if (!residuals) {
          this.use(this.programs[1], { place: "l_place", moved: "l_moved", normal: "l_normal", value: "l_value" },
            { ...common, size: 1, line: 1 });
          gl.drawArrays(gl.LINES, 0, this.buffers.l_place.count);
        }
        this.use(this.programs[1], { place: "p_place", moved: "p_moved", normal: "p_normal", value: "p_value" },
          { ...common, size, line: 0 });
        gl.drawArrays(gl.POINTS, 0, this.buffers.p_place.count);
      }
      this.annotate(camera, w, h, ratio);
    }
    // Rows right, up, away from the viewer; in the unit of the object's half size.
    camera(w, h) {
      const [ca, sa] = [Math.cos(view.azimuth), Math.sin(view.azimuth)];
      const [ce, se] = [Math.cos(view.elevation), Math.sin(view.elevation)];
      const right = [-sa, ca, 0], up = [-se * ca, -se * sa, ce], back = [-ce * ca, -ce * sa, -se];
      const s = (view.zoom * Math.min(w, h)) / data.radius;
      const rows = [right.map((x) => (x * s) / w), up.map((x) => (x * s) / h), back.map((x) => (0.45 * x) / data.radius)];
      const m = new Float32Array(16);
      rows.forEach((row, r) => row.forEach((x, c) => { m[4 * c + r] = x; }));
      m[15] = 1;
      return m;
    }
    project(camera, p, w, h) {
      const at = (r) => camera[r] * p[0] + camera[4 + r] * p[1] + camera[8 + r] * p[2];
      return [(0.5 + 0.5 * at(0)) * w, (0.5 - 0.5 * at(1)) * h, at(2)];
    }
    annotate(camera, w, h, ratio) {
      const pen = this.pen, one = probings[state.probing];
      pen.setTransform(1, 0, 0, 1, 0, 0);
      pen.drawImage(this.canvas, 0, 0);
      pen.setTransform(ratio, 0, 0, ratio, 0, 0);
      const size = Math.hypot(...one.force);
      if (size > 0) {
        const reach = (0.42 * data.radius) / size;
        const tip = this.project(camera, one.contact, w, h);
        const tail = this.project(camera, one.contact.map((x, c) => x - reach * one.force[c]), w, h);
        const angle = Math.atan2(tip[1] - tail[1], tip[0] - tail[0]);
        const long = Math.hypot(tip[0] - tail[0], tip[1] - tail[1]);
        pen.lineWidth = 3;
        pen.strokeStyle = pen.fillStyle = "#D55E00";
        pen.beginPath();
        pen.moveTo(tail[0], tail[1]);
        pen.lineTo(tip[0] - Math.min(9, long) * Math.cos(angle), tip[1] - Math.min(9, long) * Math.sin(angle));
        pen.stroke();
        pen.beginPath();
        pen.moveTo(tip[0], tip[1]);
        for (const turn of [0.42, -0.42]) pen.lineTo(tip[0] - 12 * Math.cos(angle + turn), tip[1] - 12 * Math.sin(angle + turn));
        pen.fill();
        const text = `${Number(size.toPrecision(3))} N`;
        pen.font = "600 13px system-ui, sans-serif";
        pen.textAlign = tail[0] > 0.75 * w ? "right" : "left";
        pen.lineWidth = 4;
        pen.strokeStyle = "white";
        const place = [tail[0] + (pen.textAlign === "right" ? -7 : 7), Math.max(tail[1] - 4, 14)];
        pen.strokeText(text, ...place);
        pen.fillStyle = "#8f3f00";
        pen.fillText(text, ...place);
      }
      this.scaleBar(w, h);
    }
    scaleBar(w, h) {
      const pen = this.pen, pixels = (0.5 * view.zoom * Math.min(w, h)) / data.radius;
      const most = (0.22 * w) / pixels, power = 10 ** Math.floor(Math.log10(most));
      const bar = Math.max(...[1, 2, 5].map((k) => k * power).filter((x) => x <= most));
      pen.fillStyle = "#1c1f24";
      pen.fillRect(12, h - 14, bar * pixels, 2.5);
      pen.font = "12px system-ui, sans-serif";
      pen.textAlign = "left";
      pen.fillText(`${Number(bar.toPrecision(1))} mm`, 12 + bar * pixels + 6, h - 9);
    }
    nearest(x, y) {
      const { clientWidth: w, clientHeight: h } = this.cover, camera = this.camera(w, h);
      const one = probings[state.probing];
      let best = null;
      for (const k of this.known) {
        const rest = [0, 1, 2].map((c) => one.points[3 * k + c]);
        const factor = state.mode === "residuals" ? 0 : state.factor;
        const at = this.project(camera, rest.map((v, c) => v + factor * one.measured[3 * k + c]), w, h);
        const far = Math.hypot(at[0] - x, at[1] - y) + 40 * this.project(camera, rest, w, h)[2];
        if (Math.hypot(at[0] - x, at[1] - y) < 14 && (!best || far < best.far)) best = { k, far };
      }
      return best && best.k;
    }
  }

  const by = (name) => root.querySelector(name);
  let pictures;
  try {
    pictures = ["measured", "simulated"].map((kind) => new Picture(by(`.${kind} .stage`), kind));
  } catch (error) {
    console.error(error);
    root.classList.add("without");
    return;
  }
  root.classList.add("with");
  const format = (x) => Number(x.toPrecision(3)).toString();
  const draw = () => requestAnimationFrame(() => pictures.forEach((one) => one.draw()));
  const choose = () => {
    const one = probings[state.probing], most = one.top, residuals = state.mode === "residuals";
    const usual = (0.15 * data.radius) / most, places = Math.floor(Math.log10(usual));
    const slider = by("input[type=range]");
    state.factor = Math.round(slider.value / 5 * usual / 10 ** (places - 1)) * 10 ** (places - 1);
    by(".factor").textContent = slider.value === "0" ? "not moved" : `${format(state.factor)} times`;
    pictures.forEach((picture) => picture.load(one, most));
    by(".measured .ticks").replaceChildren(...ticks(residuals ? data.most_sigmas : most, residuals ? "sigmas, and more" : "mm"));
    by(".simulated .ticks").replaceChildren(...ticks(most, "mm"));
    by(".measured h3").textContent = residuals ? "Measured \u2212 simulated, in sigmas" : "Measured";
    by(".told").textContent = by(".told").dataset.hint;
    draw();
  };
  const ticks = (most, unit) => [0, 0.5, 1].map((share, k) => {
    const tick = document.createElement("span");
    tick.textContent = format(share * most) + (k === 2 ? ` ${unit}` : "");
    return tick;
  });
  by("select").addEventListener("change", (event) => { state.probing = Number(event.target.value); choose(); });
  by("input[type=range]").addEventListener("input", choose);
  root.querySelectorAll("input[type=radio]").forEach((input) =>
    input.addEventListener("change", () => { state.mode = input.value; choose(); }));
  const turn = (x, y) => {
    view.azimuth -= x;
    view.elevation = Math.max(-1.57, Math.min(1.57, view.elevation + y));
    draw();
  };
  root.querySelectorAll("[data-zoom]").forEach((button) => button.addEventListener("click", () => {
    const factor = Number(button.dataset.zoom);
    if (factor) view.zoom = Math.max(0.4, Math.min(12, view.zoom * factor));
    else Object.assign(view, { azimuth: data.azimuth, elevation: data.elevation, zoom: 1 });
    draw();
  }));
  pictures.forEach((picture) => {
    const cover = picture.cover;
    let last = null;
    cover.tabIndex = 0;
    cover.setAttribute("role", "img");
    cover.setAttribute("aria-label", `${picture.kind} surface; arrow keys turn it`);
    cover.addEventListener("pointerdown", (event) => {
      last = [event.clientX, event.clientY];
      cover.setPointerCapture(event.pointerId);
    });
    cover.addEventListener("pointermove", (event) => {
      if (last) turn((event.clientX - last[0]) / 140, (event.clientY - last[1]) / 140);
      if (last) last = [event.clientX, event.clientY];
      if (picture.kind === "measured") tell(picture, event);
    });
    for (const name of ["pointerup", "pointercancel"]) cover.addEventListener(name, () => { last = null; });
    cover.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-0.15, 0], ArrowRight: [0.15, 0], ArrowUp: [0, 0.15], ArrowDown: [0, -0.15] }[event.key];
      if (step) { turn(...step); event.preventDefault(); }
    });
  });
  const tell = (picture, event) => {
    const box = picture.cover.getBoundingClientRect(), one = probings[state.probing];
    const k = picture.nearest(event.clientX - box.left, event.clientY - box.top);
    if (k === null) return;
    by(".told").textContent = `Point ${one.rows[k]}: measured ${format(length(one.measured, k))} mm, simulated `
      + `${format(length(one.predicted, k))} mm, apart by ${format(one.sigmas[k])} sigmas`;
  };
  Object.assign(view, { azimuth: data.azimuth, elevation: data.elevation });
  new ResizeObserver(draw).observe(root);
  choose();
})();
