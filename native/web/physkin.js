// Clothes computed in this tab: joint positions in, vertices and normals of garments out, on one thread.
//
// What is loaded is the file that `physkin bind` writes: garments on one avatar, gzipped or not. Metres, radians, the
// avatar's root frame in glTF's axes: x left, y up, z forward. What is wrong is thrown as PhyskinError, one sentence.

import { bytesOf, NativeModule, PhyskinError, ROW } from "./native_module.js";

export { PhyskinError };

const UPRIGHT = [0, 0, 0, 0, 0, 0, 1];

/** An outfit from its address, a Response, or its bytes. See physkin.d.ts. */
export async function loadOutfit(source, { wasm } = {}) {
  const [module, file] = await Promise.all([NativeModule.load(wasm), bytesOf(source).then(inflated)]);
  return new Outfit(module, file);
}

class Outfit {
  #module;
  #native;
  #handle;
  #joints; // places in the module's memory of what a frame reads and writes
  #input;
  #rows;
  #index = new Map();
  #positions;

  /** @private */
  constructor(module, file) {
    this.#module = module;
    const native = (this.#native = module.native);
    this.#handle = this.#open(file);
    const joints = native.physkin_joint_count(this.#handle);
    const vertices = native.physkin_vertex_count(this.#handle);
    this.#joints = this.#module.room(4 * joints);
    this.#input = this.#module.room(8 * UPRIGHT.length);
    this.#rows = this.#module.room(4 * ROW * vertices);
    this.joints = Array.from({ length: joints }, (_, joint) => this.#readJoint(joint));
    this.joints.forEach(({ name }, joint) => this.#index.set(name, joint));
    this.#positions = Float32Array.from(this.joints, ({ rest }) => rest);
    this.bones = bonesOf(this.joints);
    this.metadata = textsOf(file);
    const parts = native.physkin_part_count(this.#handle);
    this.garments = Array.from({ length: parts }, (_, part) => this.#readGarment(part));
    const memory = native.memory.buffer.slice();
    this.step({}); // so that what is drawn before the first frame hangs at rest; layers would remember it
    this.#module.view(Uint8Array, 0, memory.byteLength).set(new Uint8Array(memory));
  }

  step(joints, { gravity, time, root } = {}) {
    const native = this.#native;
    this.#fill(joints);
    this.#module.view(Float32Array, this.#joints, this.#positions.length).set(this.#positions);
    let status;
    if (time === undefined && root === undefined) {
      const [x, y, z] = direction(gravity ?? [0, -1, 0]);
      this.#module.view(Float32Array, this.#input, 3).set([z, x, y]);
      status = native.physkin_step(this.#handle, this.#joints, this.#input, this.#rows, ROW, ROW);
    } else {
      if (gravity !== undefined) throw new PhyskinError("gravity is of a root at rest; give either it or time and root");
      if (!Number.isFinite(time)) throw new PhyskinError(`time is ${time}; it must be a finite number of seconds`);
      const [x, y, z, i, j, k, w] = numbers("root", root ?? UPRIGHT, UPRIGHT.length);
      this.#module.view(Float64Array, this.#input, UPRIGHT.length).set([z, x, y, k, i, j, w]);
      status = native.physkin_step_moving(this.#handle, this.#joints, time, this.#input, this.#rows, ROW, ROW);
    }
    this.#module.check(status);
    let at = this.#rows;
    for (const { positions, normals } of this.garments) {
      this.#module.copyRows(at, positions, normals);
      at += 4 * ROW * (positions.length / 3);
    }
  }

  set sway(amount) {
    this.#module.check(this.#native.physkin_set_sway(this.#handle, amount));
  }

  set wind(velocity) {
    const [x, y, z] = numbers("wind", velocity, 3);
    this.#module.view(Float64Array, this.#input, 3).set([z, x, y]);
    this.#module.check(this.#native.physkin_set_wind(this.#handle, this.#input));
  }

  reset() {
    this.#module.check(this.#native.physkin_reset(this.#handle));
  }

  boneRotations(joints) {
    this.#fill(joints);
    return new Map(this.bones.map(({ name, joints }) => [name, this.#rotationOf(joints)]));
  }

  // --- Joint positions ---

  #fill(joints) {
    const { length } = this.#positions;
    if (Array.isArray(joints) || ArrayBuffer.isView(joints)) {
      if (joints.length !== length) throw new PhyskinError(`got ${joints.length} joint positions; expected ${length}`);
      this.#positions.set(joints);
    } else {
      for (let joint = 0; joint < length; ++joint) this.#positions[joint] = this.joints[joint].rest;
      for (const [name, position] of Object.entries(joints)) {
        const joint = this.#index.get(name);
        if (joint === undefined) throw new PhyskinError(`there is no joint "${name}"; outfit.joints names all ${length}`);
        this.#positions[joint] = position;
      }
    }
    for (let joint = 0; joint < length; ++joint) {
      if (!Number.isFinite(this.#positions[joint])) {
        const { name } = this.joints[joint];
        throw new PhyskinError(`joint "${name}" is ${this.#positions[joint]}; positions are finite numbers in radians`);
      }
    }
  }

  // Rotations about the joints' axes, one after the other.
  #rotationOf(joints) {
    let [x, y, z, w] = [0, 0, 0, 1];
    for (const joint of joints) {
      const { axis, rest } = this.joints[joint];
      const half = (this.#positions[joint] - rest) / 2;
      const [sine, c] = [Math.sin(half), Math.cos(half)];
      const [i, j, k] = axis.map((each) => each * sine);
      [x, y, z, w] = [
        w * i + x * c + y * k - z * j,
        w * j - x * k + y * c + z * i,
        w * k + x * j - y * i + z * c,
        w * c - x * i - y * j - z * k,
      ];
    }
    return [x, y, z, w];
  }

  // --- The file ---

  #open(file) {
    const place = this.#module.room(file.length);
    const handle = this.#module.room(4);
    try {
      this.#module.view(Uint8Array, place, file.length).set(file);
      this.#module.check(this.#native.physkin_open_memory(place, file.length, 0, handle));
      return this.#module.view(Uint32Array, handle, 1)[0];
    } finally {
      this.#native.free(place);
      this.#native.free(handle);
    }
  }

  #readJoint(joint) {
    const [native, at] = [this.#native, this.#input];
    this.#module.check(native.physkin_joint_range(this.#handle, joint, at, at + 4, at + 8));
    const [lower, rest, upper] = this.#module.view(Float32Array, at, 3);
    this.#module.check(native.physkin_joint_axis(this.#handle, joint, at));
    const [x, y, z] = this.#module.view(Float32Array, at, 3);
    const name = this.#module.text(native.physkin_joint_name(this.#handle, joint));
    return { name, lower, rest, upper, axis: [y, z, x] };
  }

  #readFabrics(part) {
    const names = [];
    for (let place; (place = this.#native.physkin_fabric_name(this.#handle, part, names.length)) !== 0; ) {
      names.push(this.#module.text(place));
    }
    return names;
  }

  #setFabric(part, name) {
    const place = this.#module.write(name);
    try {
      this.#module.check(this.#native.physkin_set_fabric(this.#handle, part, place));
    } finally {
      this.#native.free(place);
    }
  }

  #readGarment(part) {
    const [native, at] = [this.#native, this.#input];
    this.#module.check(native.physkin_part_range(this.#handle, part, at, at + 4, at + 8, at + 12));
    const [first, count, firstFace, faceCount] = this.#module.view(Int32Array, at, 4);
    const all = native.physkin_faces(this.#handle) + 12 * firstFace;
    const fabrics = this.#readFabrics(part);
    const setFabric = (name) => this.#setFabric(part, name);
    let fabric = fabrics[0];
    return {
      fabrics,
      get fabric() {
        return fabric;
      },
      set fabric(name) {
        setFabric(name);
        fabric = name;
      },
      name: this.#module.text(native.physkin_part_name(this.#handle, part)),
      faces: Uint32Array.from(this.#module.view(Int32Array, all, 3 * faceCount), (vertex) => vertex - first),
      positions: new Float32Array(3 * count),
      normals: new Float32Array(3 * count),
    };
  }
}

// --- Files ---

// Texts of a bound file that was opened, which are for hosts such as this one and come first (bound_file.py).
function textsOf(file) {
  const [view, decoder] = [new DataView(file.buffer, file.byteOffset), new TextDecoder()];
  let at = 16;
  const number = () => view.getUint32((at += 4) - 4, true);
  const text = () => {
    const size = number();
    return decoder.decode(file.subarray(at, (at += size)));
  };
  return Object.fromEntries(Array.from({ length: number() }, () => [text(), text()]));
}

// Joints are called BONE_x, BONE_y or BONE_z; those of one bone turn it in their order.
function bonesOf(joints) {
  const bones = new Map();
  joints.forEach(({ name }, joint) => {
    const bone = name.replace(/_[xyz]$/, "");
    bones.set(bone, [...(bones.get(bone) ?? []), joint]);
  });
  return Array.from(bones, ([name, its]) => ({ name, joints: its }));
}

function numbers(what, given, count) {
  const values = Array.from(given);
  if (values.length === count && values.every(Number.isFinite)) return values;
  throw new PhyskinError(`${what} is [${values.join(", ")}]; expected ${count} finite numbers`);
}

function direction(gravity) {
  const values = numbers("gravity", gravity, 3);
  if (Math.abs(Math.hypot(...values) - 1) < 1e-3) return values;
  throw new PhyskinError(`gravity is [${values.join(", ")}]; expected a unit direction`);
}

async function inflated(bytes) {
  if (bytes[0] !== 0x1f || bytes[1] !== 0x8b) return bytes;
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  try {
    return new Uint8Array(await new Response(stream).arrayBuffer());
  } catch {
    throw new PhyskinError(`the file of ${bytes.length} bytes is cut off or damaged: it cannot be inflated`);
  }
}
