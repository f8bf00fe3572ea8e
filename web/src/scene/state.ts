// What the scene page shows at the moment; every change is followed by a new picture.

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
  /** Two pictures side by side: the detector's points in the world, and the body fitted to them. */
  isCompared: boolean
  detections: boolean
  reprojection: boolean
  residuals: boolean
  person: number | null
  camera: number | null
  /** The camera that is looked through. */
  through: number | null
}

export type Switch =
  | 'body' | 'skeleton' | 'points' | 'trails' | 'cameras' | 'names' | 'isCompared'
  | 'detections' | 'reprojection' | 'residuals'

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
    isCompared: false,
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
  { name: 'isCompared', label: 'Compare', key: 'v', title: 'Points before the body, beside the body', inCamera: false },
  { name: 'trails', label: 'Trails', key: 't', title: 'Paths on the floor', inCamera: false },
  { name: 'cameras', label: 'Cameras', key: 'c', title: 'Frusta of the cameras', inCamera: false },
  { name: 'names', label: 'Names', key: 'n', title: 'Names of people and cameras', inCamera: false },
  { name: 'detections', label: 'Detections', key: 'd', title: 'What the detector saw', inCamera: true },
  { name: 'reprojection', label: 'Reprojection', key: 'r', title: 'The body as this camera should see it', inCamera: true },
  { name: 'residuals', label: 'Distances', key: 'e', title: 'From each detected point to where it should be', inCamera: true },
]
