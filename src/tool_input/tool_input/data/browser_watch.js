// Runs in the page before its own scripts and listens to what passes between the page and the
// worker that holds its connection, and to what the page draws. `watch` is what was heard.
(() => {
  const watch = {
    worker: null,     // what holds the connection
    camera: null,     // the newest ViewerCameraMessage
    meshes: {},       // by name: {vertices: Float32Array, faces: Uint32Array, visible}
    pointer: [],      // times of pointer moves [ms]
    sent: [],         // [time, message] of each message that the page sends
    batches: [],      // [time, bytes, places of the followed vertices or null] of each batch
    frames: [],       // [time, pixels changed in the region, whether the organ is a newer one]
    follow: null,     // {mesh, vertices: [rows]}: whose places to note
    blind: false,     // whether nothing is drawn, to see what all else takes
    region: null,     // [x, y, width, height] in the window, from its upper left corner
  };
  window.watch = watch;

  const numbers = (given, Kind) =>
    given instanceof Kind ? given : new Kind(given.buffer, given.byteOffset, given.byteLength / 4);

  const keep = (message) => {
    if (message.type === "RemoveSceneNodeMessage") delete watch.meshes[message.name];
    if (message.type === "SetSceneNodeVisibilityMessage" && watch.meshes[message.name])
      watch.meshes[message.name].visible = message.visible;
    const { vertices, faces } = message.props || message.updates || {};
    if (!vertices && !faces) return null;
    const mesh = (watch.meshes[message.name] = watch.meshes[message.name] || { visible: true });
    if (vertices) mesh.vertices = numbers(vertices, Float32Array);
    if (faces) mesh.faces = numbers(faces, Uint32Array);
    return vertices || faces;
  };

  let newer = false;  // whether the organ has come since the last frame
  const hear = (messages) => {
    let bytes = 0, moved = false;
    for (const message of messages) {
      const given = keep(message);
      if (!given) continue;
      bytes = given.buffer.byteLength;  // of the whole batch: its arrays are views into it
      moved = moved || (watch.follow && message.name === watch.follow.mesh);
    }
    const { vertices } = (moved && watch.meshes[watch.follow.mesh]) || {};
    const places = vertices
      ? watch.follow.vertices.map((row) => Array.from(vertices.subarray(3 * row, 3 * row + 3)))
      : null;
    newer = newer || bytes > 0;
    watch.batches.push([performance.now(), bytes, places]);
  };

  const Worker = window.Worker;
  window.Worker = class extends Worker {
    constructor(...given) {
      super(...given);
      this.addEventListener("message", ({ data }) => {
        if (data && data.type === "message_batch") {
          watch.worker = this;
          hear(data.messages);
        }
      });
    }
    postMessage(data, transferred) {
      if (data && data.type === "send") {
        if (data.message.type === "ViewerCameraMessage") watch.camera = data.message;
        watch.sent.push([performance.now(), data.message]);
      }
      return super.postMessage(data, transferred);
    }
  };

  window.addEventListener("pointermove", (event) => watch.pointer.push(event.timeStamp), true);

  // The page draws only when something changed: a frame ends with the callback that drew it.
  let drawing = false, before = null;
  const changed = (gl) => {
    if (!watch.region) return 0;
    // The page draws with fewer pixels than the window has while it cannot keep up.
    const scale = gl.drawingBufferWidth / gl.canvas.clientWidth;
    const [left, top, width, height] = watch.region.map((length) => Math.round(scale * length));
    const [x, y] = [left, gl.drawingBufferHeight - top - height];
    const pixels = new Uint8Array(4 * width * height);
    const target = gl.getParameter(gl.DRAW_FRAMEBUFFER_BINDING);
    const source = gl.getParameter(gl.READ_FRAMEBUFFER_BINDING);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.readPixels(x, y, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, target);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, source);
    let count = 0;
    for (let i = 0; before && before.length === pixels.length && i < pixels.length; i += 4) {
      const difference = Math.abs(pixels[i] - before[i]) + Math.abs(pixels[i + 1] - before[i + 1])
        + Math.abs(pixels[i + 2] - before[i + 2]);
      if (difference > 12) count += 1;
    }
    before = pixels;
    return count;
  };
  for (const name of ["drawElements", "drawArrays"]) {
    const draw = WebGL2RenderingContext.prototype[name];
    WebGL2RenderingContext.prototype[name] = function (...given) {
      if (!drawing) {
        drawing = true;
        queueMicrotask(() => {
          drawing = false;
          const count = changed(this);
          watch.frames.push([performance.now(), count, newer]);
          newer = false;
        });
      }
      if (!watch.blind) draw.apply(this, given);
    };
  }
})();
