// Scene of a result: cameras and people over time, from `stages/motion.bin`.

import { type ArrayRef, Described } from './described'

export interface Camera {
  id: string
  width: number
  height: number
  K: number[][]
  dist: number[]
  /** Distortion model, if it is not the polynomial model. */
  distortion_model?: 'rational' | 'fisheye'
  R: number[][] | null
  t: number[] | null
  position: number[] | null
  reprojection_px: { mean: number; median: number } | null
  n_observations: number
  sigma_position_mm?: number
  sigma_angle_deg?: number
}

export interface Person {
  id: number
  /** Frame index of row 0. */
  first: number
  n_frames: number
  /** Shape, population standard deviations; null in results of earlier versions. */
  betas: number[] | null
  /** [frames, 24, 3], world metres. */
  joints: Float32Array
  /** [frames, 24, 4]: `world_from_joint` as quaternions x y z w, `QUATERNION_UNIT` for 1; null as above. */
  rotations: Int16Array | null
  /** [frames]: 0 where the pose is not supported by observations. */
  valid: Uint8Array
  /** [frames, K, 3], world metres; NaN: unknown. */
  keypoints: Float32Array
  /** [frames, K]: cameras that saw each keypoint. */
  n_views: Uint8Array
  /** [frames, 2, 15, 3]: finger joints of the left and the right hand, world metres; null where hands were not fitted. */
  fingers: Float32Array | null
  /** [frame index, camera index] where the track of the detector changed person and was repaired. */
  repairs: [number, number][]
}

export interface Motion {
  name: string
  fps: number
  first_frame: number
  n_frames: number
  up_axis: 'y' | 'z'
  joint_names: string[]
  joint_parents: (number | null)[]
  keypoint_names: string[]
  cameras: Camera[]
  people: Person[]
  /** Body joints that carry the left and the right hand, and parents of the finger joints (null: that body joint); null without hands. */
  hands: { wrists: number[]; parents: (number | null)[] } | null
  /** Body model of the fit; null in results of earlier versions. */
  body_model: { name: string; sha256: string } | null
  /** [cameras, n_frames]: number of detections that were not assigned to a person. */
  rejected: Uint8Array
  /** [cameras, n_frames]: number of detections with exchanged or rejected keypoints; null without the consistency stage. */
  repaired: Uint8Array | null
}

export const N_JOINTS = 24
export const QUATERNION_UNIT = 32767

interface Header extends Omit<Motion, 'cameras' | 'people' | 'rejected' | 'repaired' | 'up_axis'> {
  world: { up_axis: 'y' | 'z'; cameras: Camera[] }
  people: (Pick<Person, 'id' | 'first' | 'repairs'> &
    Record<'joints' | 'valid' | 'keypoints' | 'n_views', ArrayRef> & { betas?: number[]; turns?: ArrayRef; fingers?: ArrayRef })[]
  rejected: ArrayRef
  repaired?: ArrayRef
}

export function readMotion(bytes: ArrayBuffer): Motion {
  const file = new Described<Header>(bytes, 'wandless.motion')
  const { world, people, rejected, repaired, ...rest } = file.header
  return {
    ...rest,
    body_model: rest.body_model ?? null,
    hands: rest.hands ?? null,
    up_axis: world.up_axis,
    cameras: world.cameras,
    people: people.map((person) => ({
      id: person.id,
      first: person.first,
      repairs: person.repairs,
      n_frames: person.joints.shape[0],
      betas: person.betas ?? null,
      joints: file.f32(person.joints),
      rotations: person.turns ? file.i16(person.turns) : null,
      valid: file.u8(person.valid),
      keypoints: file.f32(person.keypoints),
      n_views: file.u8(person.n_views),
      fingers: person.fingers ? file.f32(person.fingers) : null,
    })),
    rejected: file.u8(rejected),
    repaired: repaired ? file.u8(repaired) : null,
  }
}

/** Row of the arrays of a person at a frame index; -1 where the person is absent. */
export function rowAt(person: Person, frame: number) {
  const row = frame - person.first
  return row >= 0 && row < person.n_frames ? row : -1
}

/** Number of finger bones of a person. */
export const N_FINGER_BONES = 30

/** Calls `draw` with both ends of every finger bone: an array of points and the index of the first coordinate in it. */
export function forEachFingerBone(
  { hands }: Motion, { fingers, joints }: Person, row: number,
  draw: (from: Float32Array, i: number, to: Float32Array, j: number) => void,
) {
  if (!hands || !fingers) return
  hands.wrists.forEach((wrist, hand) => {
    const at = (row * hands.wrists.length + hand) * hands.parents.length
    hands.parents.forEach((parent, joint) => {
      if (parent === null) draw(joints, 3 * (row * N_JOINTS + wrist), fingers, 3 * (at + joint))
      else draw(fingers, 3 * (at + parent), fingers, 3 * (at + joint))
    })
  })
}

/** Edges between keypoint names; a convention may lack some of them. */
const EDGES = [
  ['nose', 'left_eye'], ['nose', 'right_eye'], ['left_eye', 'left_ear'], ['right_eye', 'right_ear'],
  ['left_shoulder', 'right_shoulder'], ['left_hip', 'right_hip'],
  ['left_shoulder', 'left_hip'], ['right_shoulder', 'right_hip'],
  ['left_shoulder', 'left_elbow'], ['left_elbow', 'left_wrist'],
  ['right_shoulder', 'right_elbow'], ['right_elbow', 'right_wrist'],
  ['left_hip', 'left_knee'], ['left_knee', 'left_ankle'],
  ['right_hip', 'right_knee'], ['right_knee', 'right_ankle'],
  ['left_ankle', 'left_heel'], ['left_ankle', 'left_big_toe'],
  ['right_ankle', 'right_heel'], ['right_ankle', 'right_big_toe'],
]

/** Keypoint index pairs that are connected by a line in drawings. */
export function keypointEdges(names: string[]): [number, number][] {
  const pairs = EDGES.map(([a, b]) => [names.indexOf(a), names.indexOf(b)] as [number, number])
  return pairs.filter(([a, b]) => a >= 0 && b >= 0)
}
