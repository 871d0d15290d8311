// Landmarks of a person in a picture, by @mediapipe/pose beside this page, in a thread of its own: an ImageBitmap in,
// { landmarks: [{ x, y, z, visibility }, ...] or null, ms } out. Metres; x right, y down, z away from the camera.

// The package takes this thread for a page: what it does in workers loads its models as scripts.
function set(name, value) {
  this[name] = value;
}
self.window = self;
self.document = {
  addEventListener() {},
  createElement: (tag) => (tag === "canvas" ? new OffscreenCanvas(1, 1) : { setAttribute: set, addEventListener: set }),
  body: {
    appendChild({ src, load }) {
      importScripts(src);
      load();
    },
  },
};
importScripts("mediapipe/pose.js");

let landmarks = null;
const pose = new Pose({ locateFile: (name) => new URL(`mediapipe/${name}`, location).href });
pose.setOptions({ modelComplexity: 0, smoothLandmarks: false, useCpuInference: true }); // the GPU draws
pose.onResults(({ poseWorldLandmarks: seen }) => {
  landmarks = seen?.map(({ x, y, z, visibility }) => ({ x, y, z, visibility })) ?? null;
});

onmessage = async ({ data: image }) => {
  const before = performance.now();
  const error = await pose.send({ image }).then(() => undefined, (wrong) => `landmarks are not found: ${wrong}`);
  postMessage({ landmarks, ms: performance.now() - before, error });
  image.close();
};
