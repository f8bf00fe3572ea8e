// State of the scene page; every change triggers a new picture.

import type { Motion } from '../data/motion'

export interface SceneState {
  /** Current time in frames; may be fractional during playback. */
  at: number
  isPlaying: boolean
  speed: number
  body: boolean
  skeleton: boolean
  points: boolean
  trails: boolean
  cameras: boolean
  names: boolean
  /** Side-by-side comparison. */
  compared: Comparison
  detections: boolean
  reprojection: boolean
  residuals: boolean
  person: number | null
  camera: number | null
  /** Camera of the current camera view. */
  through: number | null
}

export type Switch =
  | 'body' | 'skeleton' | 'points' | 'trails' | 'cameras' | 'names'
  | 'detections' | 'reprojection' | 'residuals'

/** `cleaning`: raw detections and detections after the consistency stage. `body`: 3D keypoints and the fitted body. */
export type Comparison = 'none' | 'cleaning' | 'body'

/** All comparisons: label, titles of the halves, and whether the comparison is also available in camera views. */
export const COMPARISONS: { name: Comparison; label: string; halves: [string, string]; inCamera: boolean }[] = [
  { name: 'none', label: 'No comparison', halves: ['', ''], inCamera: true },
  { name: 'cleaning', label: 'Raw | denoised', halves: ['Raw: detected and tracked', 'Denoised: repaired and adjusted'], inCamera: true },
  { name: 'body', label: 'Points | body', halves: ['3D keypoints after bundle adjustment', 'Fitted body'], inCamera: false },
]

/** Comparisons for which the result contains the data. */
export function comparisonsOf(motion: Motion, isThrough: boolean) {
  return COMPARISONS.filter(({ name, inCamera }) => (inCamera || !isThrough) && (name !== 'cleaning' || motion.repaired !== null))
}

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4]

export function initialState(): SceneState {
  return {
    at: 0,
    isPlaying: false,
    speed: 1,
    body: true,
    skeleton: false,
    points: false,
    trails: true,
    cameras: true,
    names: true,
    compared: 'none',
    detections: true,
    reprojection: true,
    residuals: true,
    person: null,
    camera: null,
    through: null,
  }
}

/** All display switches: label, key and description. */
export const SWITCHES: { name: Switch; label: string; key: string; title: string; inCamera: boolean }[] = [
  { name: 'body', label: 'Body', key: 'b', title: 'Fitted bodies', inCamera: false },
  { name: 'skeleton', label: 'Skeleton', key: 's', title: 'Skeletons with 24 joints', inCamera: false },
  { name: 'points', label: 'Points', key: 'p', title: '3D keypoints before the body fit', inCamera: false },
  { name: 'trails', label: 'Trails', key: 't', title: 'Paths on the floor', inCamera: false },
  { name: 'cameras', label: 'Cameras', key: 'c', title: 'Camera frusta', inCamera: false },
  { name: 'names', label: 'Labels', key: 'n', title: 'Labels of people and cameras', inCamera: false },
  { name: 'detections', label: 'Detections', key: 'd', title: '2D detections', inCamera: true },
  { name: 'reprojection', label: 'Reprojection', key: 'r', title: 'Reprojected body', inCamera: true },
  { name: 'residuals', label: 'Errors', key: 'e', title: 'Reprojection error of each keypoint', inCamera: true },
]
