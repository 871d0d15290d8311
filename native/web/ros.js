// Garments that a running ROS node drapes, skinned in this tab: its ~/mesh once, then its ~/garment_nodes, some 19 KB
// a frame, through rosbridge and roslib. Axes and errors are those of physkin.js.
import { Topic } from "roslib";
import { NativeModule, PhyskinError, ROW } from "./native_module.js";

const MESH = "physkin_msgs/msg/GarmentMesh";
const NODES = "physkin_msgs/msg/GarmentNodes";

// Fields of the mesh in the order of physkin_mesh in physkin.h, and how long each is.
const COUNTS = [
  ...["vertex_count", "face_count", "node_count", "influences"],
  ...["detail_node_count", "detail_influences"],
];
const ARRAYS = [
  ["faces", Uint32Array, (mesh) => 3 * mesh.face_count],
  ["rest_vertices", Float32Array, (mesh) => 3 * mesh.vertex_count],
  ["rest_normals", Float32Array, (mesh) => 3 * mesh.vertex_count],
  ["node_rest", Float32Array, (mesh) => 3 * mesh.node_count],
  ["influence_nodes", Uint32Array, (mesh) => mesh.influences * mesh.vertex_count],
  ["influence_weights", Float32Array, (mesh) => mesh.influences * mesh.vertex_count],
  ["detail_nodes", Uint32Array, (mesh) => mesh.detail_influences * mesh.vertex_count],
  ["detail_weights", Float32Array, (mesh) => mesh.detail_influences * mesh.vertex_count],
];

/** What the topics of garments that are published now are below, such as "/drape_node" or "/drape_node/tshirt". */
export function garmentTopics(ros) {
  return new Promise((resolve, reject) => {
    const found = (topics) => resolve(topics.map((topic) => topic.replace(/\/mesh$/, "")).sort());
    ros.getTopicsForType(MESH, found, (error) => reject(new PhyskinError(`rosapi does not name topics: ${error}`)));
  });
}

/** Vertices from garment nodes: a `physkin_msgs/GarmentMesh` and then a `GarmentNodes` a frame. */
export class GarmentSkin {
  #module;
  #handle;
  #input;
  #rows;

  static async of(mesh, { wasm } = {}) {
    return new GarmentSkin(await NativeModule.load(wasm), mesh);
  }

  /** @private */
  constructor(module, mesh) {
    this.#module = module;
    this.name = mesh.model_name;
    this.revision = mesh.revision;
    this.jointNames = mesh.joint_names;
    this.sizes = { transforms: 12 * mesh.node_count, detail_offsets: 3 * mesh.detail_node_count };
    this.#handle = this.#open({ ...mesh, face_count: mesh.faces.length / 3 });
    this.faces = Uint32Array.from(mesh.faces);
    this.positions = inAxesOfGltf(mesh.rest_vertices);
    this.normals = inAxesOfGltf(mesh.rest_normals);
    this.#input = module.room(4 * (this.sizes.transforms + this.sizes.detail_offsets));
    this.#rows = module.room(4 * ROW * mesh.vertex_count);
  }

  /** Writes positions and normals. A frame that throws leaves them as they were. */
  skin(nodes) {
    if (nodes.revision !== this.revision) {
      throw new PhyskinError(`garment nodes of revision ${nodes.revision}; the mesh has revision ${this.revision}`);
    }
    for (const [field, length] of Object.entries(this.sizes)) {
      if (nodes[field].length !== length) {
        throw new PhyskinError(`garment nodes have ${nodes[field].length} numbers of ${field}; the mesh wants ${length}`);
      }
    }
    const [module, offsets] = [this.#module, this.#input + 4 * this.sizes.transforms];
    module.view(Float32Array, this.#input, this.sizes.transforms).set(nodes.transforms);
    module.view(Float32Array, offsets, this.sizes.detail_offsets).set(nodes.detail_offsets);
    module.check(module.native.physkin_skin(this.#handle, this.#input, offsets, this.#rows, ROW, ROW));
    module.copyRows(this.#rows, this.positions, this.normals);
  }

  #open(mesh) {
    const [module, words] = [this.#module, 1 + COUNTS.length + ARRAYS.length];
    const places = ARRAYS.map(([field, Type, length]) => placed(module, mesh, field, Type, length(mesh)));
    const given = module.room(4 * words);
    const handle = module.room(4);
    try {
      const counts = COUNTS.map((field) => mesh[field]);
      module.view(Uint32Array, given, words).set([4 * words, ...counts, ...places]);
      module.check(module.native.physkin_skinner_open(given, 0, handle));
      return module.view(Uint32Array, handle, 1)[0];
    } catch (error) {
      throw new PhyskinError(`garment mesh "${mesh.model_name}": ${error.message}`);
    } finally {
      [...places, given, handle].forEach((place) => module.native.free(place));
    }
  }
}

function inAxesOfGltf(vectors) {
  return Float32Array.from(vectors, (_, at) => vectors[at - (at % 3) + ((at + 1) % 3)]);
}

function placed(module, mesh, field, Type, length) {
  const numbers = mesh[field];
  if (numbers?.length !== length) {
    throw new PhyskinError(`garment mesh "${mesh.model_name}": ${field} has ${numbers?.length} numbers; expected ${length}`);
  }
  const place = module.room(4 * length);
  module.view(Type, place, length).set(numbers);
  return place;
}

/** Subscribes to one garment. topics: as `garmentTopics` names them. onMesh(skin): another mesh has come, the first one
 * too. onFrame(skin): its positions and normals are new. onError(error): what was wrong with a message, which is skipped. */
export class GarmentClient {
  /** Frames that came without a mesh of their revision, or were wrong. */
  skipped = 0;
  #skin = null;
  #latest = 0;
  #topics;

  constructor(ros, topics, { onMesh = () => {}, onFrame = () => {}, onError = console.error, wasm } = {}) {
    const topic = (name, messageType) => new Topic({ ros, name: `${topics}/${name}`, messageType, compression: "cbor" });
    const mesh = topic("mesh", MESH);
    const nodes = topic("garment_nodes", NODES);
    this.#topics = [mesh, nodes];
    mesh.subscribe(async (message) => {
      const order = ++this.#latest;
      try {
        const skin = await GarmentSkin.of(message, { wasm });
        if (order !== this.#latest) return; // another one has come since
        this.#skin = skin;
        onMesh(skin);
      } catch (error) {
        onError(error);
      }
    });
    nodes.subscribe((message) => {
      if (message.revision !== this.#skin?.revision) return void ++this.skipped;
      try {
        this.#skin.skin(message);
      } catch (error) {
        ++this.skipped;
        return onError(error);
      }
      onFrame(this.#skin);
    });
  }

  close() {
    ++this.#latest;
    this.#topics.forEach((topic) => topic.unsubscribe());
  }
}
