// What the scene page shows at the moment; every change is followed by a new picture.

import type { Motion } from '../data/motion'

export interface SceneState {
  /** Time on the session's line, in frames, whole or not. */
  at: number
  isPlaying: boolean
  speed: number
  body: boolean
  skeleton: boolean
  points: boolean
  trails: boolean
  cameras: boolean
  names: boolean
  /** Two pictures side by side. */
  compared: Comparison
  detections: boolean
  reprojection: boolean
  residuals: boolean
  person: number | null
  camera: number | null
  /** The camera that is looked through. */
  through: number | null
}

export type Switch =
  | 'body' | 'skeleton' | 'points' | 'trails' | 'cameras' | 'names'
  | 'detections' | 'reprojection' | 'residuals'

/** `cleaning`: what came in, beside what the consistency stage left. `body`: adjusted points, beside the body fitted to them. */
export type Comparison = 'none' | 'cleaning' | 'body'

/** Every comparison: its name in the list, what stands over either half, and whether it is made through a camera, too. */
export const COMPARISONS: { name: Comparison; label: string; halves: [string, string]; inCamera: boolean }[] = [
  { name: 'none', label: 'One picture', halves: ['', ''], inCamera: true },
  { name: 'cleaning', label: 'Raw | denoised', halves: ['Raw: as detected and tracked', 'Denoised: consistent, adjusted'], inCamera: true },
  { name: 'body', label: 'Points | body', halves: ['Points, after bundle adjustment', 'Body, fitted to them'], inCamera: false },
]

/** The comparisons that a result has the data for. */
export function comparisonsOf(motion: Motion, isThrough: boolean) {
  return COMPARISONS.filter(({ name, inCamera }) => (inCamera || !isThrough) && (name !== 'cleaning' || motion.mended !== null))
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

/** Every switch: its name on the page, its key, what it shows. */
export const SWITCHES: { name: Switch; label: string; key: string; title: string; inCamera: boolean }[] = [
  { name: 'body', label: 'Body', key: 'b', title: 'The fitted body', inCamera: false },
  { name: 'skeleton', label: 'Skeleton', key: 's', title: 'The 24 joints of the body', inCamera: false },
  { name: 'points', label: 'Points', key: 'p', title: "The detector's points in the world, before the body", inCamera: false },
  { name: 'trails', label: 'Trails', key: 't', title: 'Paths on the floor', inCamera: false },
  { name: 'cameras', label: 'Cameras', key: 'c', title: 'Frusta of the cameras', inCamera: false },
  { name: 'names', label: 'Names', key: 'n', title: 'Names of people and cameras', inCamera: false },
  { name: 'detections', label: 'Detections', key: 'd', title: 'What the detector saw', inCamera: true },
  { name: 'reprojection', label: 'Reprojection', key: 'r', title: 'The body as this camera should see it', inCamera: true },
  { name: 'residuals', label: 'Distances', key: 'e', title: 'From each detected point to where it should be', inCamera: true },
]
