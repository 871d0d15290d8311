// The visitor as the page's motion: landmarks in the camera's picture, found in this tab, as joint positions.
import * as THREE from "three";
import { LandmarkReader } from "./landmarks.js";

const SAID = { seen: "You are seen.", lost: "Nobody is seen: step into the picture." };
const COUNTED = 30; // landmark frames that the times said are taken of

/** An open camera. `after` is called once a drawn frame; between landmarks it moves on evenly. */
export class Camera {
  #video;
  #stream;
  #reader;
  #scale;
  #say;
  #worker = new Worker(new URL("landmark_worker.js", import.meta.url));
  #busy = false;
  #picture = -1; // its time in the video
  #from = null; // poses: what was shown when the last one came, and that
  #to = null;
  #came = 0;
  #between = 1; // [ms] from one to the next
  times = []; // [ms] that landmarks took

  /** video: shows the picture. scale: of the avatar's legs to the default's. say: is told what is seen. Throws where there
   * is no camera, or the visitor does not allow it. */
  static async open(video, outfit, scale, say) {
    const table = await (await fetch("camera.json")).json();
    if (!navigator.mediaDevices) throw new Error("browsers lend a camera to https:// and localhost pages only");
    const wanted = { width: 480, height: 360, facingMode: "user" };
    video.srcObject = await navigator.mediaDevices.getUserMedia({ video: wanted, audio: false });
    await video.play();
    return new Camera(video, new LandmarkReader(table, outfit.joints), scale, say);
  }

  /** @private */
  constructor(video, reader, scale, say) {
    [this.#video, this.#stream, this.#reader, this.#scale, this.#say] = [video, video.srcObject, reader, scale, say];
    this.#worker.onmessage = ({ data }) => this.#take(data);
    this.#worker.onerror = ({ message }) => this.#take({ error: message });
    this.#say("Finding you …");
  }

  /** Joint positions and root now; null until the first landmarks come. */
  after() {
    if (!this.#busy && this.#video.currentTime !== this.#picture) this.#look();
    if (this.#to === null) return null;
    const share = Math.min((performance.now() - this.#came) / this.#between, 1);
    const mix = (from, to) => from.map((value, at) => value + share * (to[at] - value));
    const [from, to] = [this.#from, this.#to].map(({ root }) => new THREE.Quaternion(...root.slice(3)));
    return {
      positions: mix(this.#from.positions, this.#to.positions),
      root: [...mix(this.#from.root, this.#to.root).slice(0, 3), ...from.slerp(to, share).toArray()],
    };
  }

  close() {
    this.#worker.terminate();
    this.#stream.getTracks().forEach((track) => track.stop());
  }

  async #look() {
    this.#busy = true;
    this.#picture = this.#video.currentTime;
    const image = await createImageBitmap(this.#video);
    this.#worker.postMessage(image, [image]);
  }

  #take({ landmarks, ms, error }) {
    if (error !== undefined) return this.#say(error);
    const now = performance.now();
    const pose = this.#reader.read(landmarks, now / 1000);
    pose.root = pose.root.map((value, at) => (at < 3 ? this.#scale * value : value));
    this.#from = this.after() ?? pose;
    [this.#to, this.#between, this.#came] = [pose, Math.min(now - this.#came, 200), now];
    this.times = [...this.times, ms].slice(-COUNTED);
    const { status, lost } = this.#reader;
    const took = this.times.reduce((a, b) => a + b) / this.times.length;
    this.#say(`${SAID[status] ?? `Not seen: ${lost.join(", ")}.`} Landmarks: ${took.toFixed(0)} ms.`);
    this.#busy = false;
  }
}
