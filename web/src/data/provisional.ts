// Provisional scene of a running job: cameras and points, from `/v1/jobs/{id}/scene`.

import { type Camera, type Motion, N_JOINTS, type Person } from './motion'

/** Point of a keypoint, world metres; null: unknown. */
type Point = [number, number, number] | null

export interface ProvisionalScene {
  /** The stage that found it. */
  stage: string
  up_axis: 'x' | 'y' | 'z'
  fps: number
  cameras: Camera[]
  keypoint_names: string[]
  /** Numbers of the shown frames: every n-th of the session. */
  frames: number[]
  people: { id: number; points: (Point[] | null)[] }[]
}

/** The scene as a motion of its shown frames, without joints and bodies. */
export function motionOf(scene: ProvisionalScene): Motion {
  const n_frames = scene.frames.length
  const stride = n_frames > 1 ? scene.frames[1] - scene.frames[0] : 1
  return {
    name: '',
    fps: scene.fps / stride,
    first_frame: scene.frames[0] ?? 0,
    n_frames,
    // The scene can only be turned to y; a given world with x up is shown as it is.
    up_axis: scene.up_axis === 'z' ? 'z' : 'y',
    joint_names: [],
    joint_parents: [],
    keypoint_names: scene.keypoint_names,
    cameras: scene.cameras,
    people: scene.people.map(({ id, points }) => person(id, points, scene.keypoint_names.length)),
    body_model: null, hands: null,
    rejected: new Uint8Array(0),
    repaired: null,
  }
}

function person(id: number, points: (Point[] | null)[], n_keypoints: number): Person {
  const n_frames = points.length
  const keypoints = new Float32Array(3 * n_frames * n_keypoints).fill(NaN)
  // Joint 0, about which the picture is centred, is the middle of the points; where the person is absent it stays.
  const joints = new Float32Array(3 * n_frames * N_JOINTS)
  let middle = middleOf(points.find((known) => known !== null) ?? [])
  points.forEach((known, row) => {
    known?.forEach((point, k) => point && keypoints.set(point, 3 * (row * n_keypoints + k)))
    if (known) middle = middleOf(known)
    joints.set(middle, 3 * row * N_JOINTS)
  })
  return {
    id, first: 0, n_frames, betas: null, joints, rotations: null, valid: new Uint8Array(n_frames).fill(1), keypoints,
    n_views: new Uint8Array(n_frames * n_keypoints), fingers: null, repairs: [],
  }
}

function middleOf(points: Point[]): [number, number, number] {
  const known = points.filter((point) => point !== null)
  const mean = (axis: number) => known.reduce((sum, point) => sum + point[axis], 0) / Math.max(known.length, 1)
  return [mean(0), mean(1), mean(2)]
}
