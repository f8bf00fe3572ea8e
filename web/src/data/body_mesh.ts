// Mesh of the default body from `/assets/default-body.bin`. It is shaped once per person and posed by the GPU.

import { type ArrayRef, Described } from './described'
import { N_JOINTS } from './motion'

const N_BETAS = 10

export interface BodyMesh {
  name: string
  sha256: string
  /** [V, 3], rest pose at beta 0, metres. */
  vertices: Float32Array
  /** [V, 3, 10], in steps of `metres_per_step`. */
  directions: Int16Array
  metres_per_step: number
  /** [24, 3] and [24, 3, 10]: rest joints and their shape directions, metres. */
  joints: Float32Array
  jointDirections: Float32Array
  /** [V, 4]: joints of each vertex and their skinning weights, 0 to 255. */
  skinJoints: Uint8Array
  skinWeights: Uint8Array
  /** [F, 3] */
  faces: Uint16Array
}

export function readBodyMesh(bytes: ArrayBuffer): BodyMesh {
  const file = new Described<Pick<BodyMesh, 'name' | 'sha256' | 'metres_per_step'> & Record<string, ArrayRef>>(bytes, 'wandless.body')
  const { header } = file
  return {
    name: header.name,
    sha256: header.sha256,
    metres_per_step: header.metres_per_step,
    vertices: file.f32(header.vertices),
    directions: file.i16(header.vertex_directions),
    joints: file.f32(header.joints),
    jointDirections: file.f32(header.joint_directions),
    skinJoints: file.u8(header.skin_joints),
    skinWeights: file.u8(header.skin_weights),
    faces: file.u16(header.faces),
  }
}

/** Vertices and joints of a shaped body in the rest pose, metres: `T + S beta`. */
export function shaped(mesh: BodyMesh, betas: number[]) {
  const add = (rest: Float32Array, directions: Int16Array | Float32Array, unit: number) =>
    rest.map((value, i) => {
      let sum = 0
      for (let b = 0; b < N_BETAS; b++) sum += directions[N_BETAS * i + b] * betas[b]
      return value + unit * sum
    })
  return {
    vertices: add(mesh.vertices, mesh.directions, mesh.metres_per_step),
    joints: add(mesh.joints, mesh.jointDirections, 1),
  }
}

/** Joint pairs whose distances measure the size of a body: thighs, shins, upper arms, forearms. */
const LIMBS = [[1, 4], [4, 7], [2, 5], [5, 8], [16, 18], [18, 20], [17, 19], [19, 21]]

/** The mean body, scaled to the limb lengths of the joints in row `at`: for people whose body model is not available. */
export function scaledMeanBody(mesh: BodyMesh, joints: Float32Array, at: number) {
  const limbLength = (points: Float32Array, first: number) =>
    LIMBS.reduce((sum, [a, b]) => {
      const [i, j] = [3 * (first + a), 3 * (first + b)]
      return sum + Math.hypot(points[i] - points[j], points[i + 1] - points[j + 1], points[i + 2] - points[j + 2])
    }, 0)
  const scale = limbLength(joints, at * N_JOINTS) / limbLength(mesh.joints, 0)
  return { vertices: mesh.vertices.map((c) => scale * c), joints: mesh.joints.map((c) => scale * c) }
}
