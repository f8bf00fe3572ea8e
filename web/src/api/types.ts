// Documents of the HTTP API, with the fields that the viewer uses.

export type State = 'queued' | 'running' | 'canceling' | 'succeeded' | 'failed' | 'canceled' | 'dead'
export type Verdict = 'pass' | 'warn' | 'reject'

/** Name of a camera, and whether the session gives its R and t. */
export interface CameraFacts {
  id: string
  has_extrinsics: boolean
  has_intrinsics: boolean
}

export interface Session {
  id: string
  name: string
  cameras: number
  frames: number
  people_max: number
  keypoint_convention: string
  format: string
  warnings: string[]
  bytes: number
  camera_facts: CameraFacts[]
  created_at: string
}

/** Inspection of a session before it is solved. */
export interface Inspection {
  cameras: { id: string; frames_with_people: number; detections: number }[]
  /** Cameras that see the same people. */
  groups: string[][]
  findings: Finding[]
  expected: { joint_error_mm: number | null; solve_s: number | null; cameras_per_person: number | null }
}

export interface Finding {
  code: string
  detail: string
}

export interface Progress {
  stage: string
  stage_index: number
  stage_count: number
  fraction: number
  message: string
  eta_s: number | null
}

export interface Quality {
  verdict: Verdict
  reasons: string[]
}

/** Reason why a job failed; the fields of a problem document. */
export interface Cause {
  code: string
  detail: string
  remedy?: string
  camera?: string | null
  frame?: number | null
  person?: number | null
  pointer?: string | null
  file?: string | null
}

/** A probable mistake in the files. */
export interface Suspicion {
  code: string
  /** The first of `cameras`; null where it is the whole recording. */
  camera: string | null
  cameras: string[]
  evidence: string
  remedy: string
  /** JSON of the option that repairs it; null where the files must be changed. */
  suggested_option: string | null
  applied: boolean
}

export interface Job {
  id: string
  state: State
  session: string
  options: Record<string, unknown>
  labels: Record<string, string>
  created_at: string
  started_at: string | null
  finished_at: string | null
  attempt: number
  progress: Progress | null
  stage_seconds: Record<string, number>
  quality: Quality | null
  /** Probable mistakes in the files; empty before the job has succeeded. */
  suspicions: Suspicion[]
  error: Cause | null
  solver_version: string
}

/** A correction of identities; people have the numbers of the result, frames those of the session. */
export type Correction =
  | { action: 'rename'; person: number; name: string }
  | { action: 'merge'; people: number[] }
  | { action: 'split'; person: number; frame: number }
  | { action: 'exchange'; people: number[]; frame: number; last_frame?: number }
  | { action: 'exclude_camera'; camera: string }
  | { action: 'exclude_person'; person: number }
  | { action: 'exclude_frames'; frames: [number, number]; camera?: string; person?: number }
  | { action: 'set_height'; person: number; metres: number }

export interface FileEntry {
  name: string
  media_type: string
  bytes: number
  sha256: string
}

export interface Manifest {
  input: { name: string; sha256: string }
  solver_version: string
  publish: { up_axis: string; frame_range: [number, number]; fps: number }
  files: FileEntry[]
}

export interface Summary {
  mean: number
  median: number
}

/** Standard deviations. */
export interface SigmaSummary {
  median: number
  p95: number
}

/** Statistics of one keypoint of one person. */
export interface KeypointStatistics {
  keypoint: string
  n_observations: number
  rejected: number
  reprojection_px: Summary | null
  reprojection_mm: Summary | null
  sigma_mm: SigmaSummary | null
}

/** Optional fields are missing in reports of earlier versions. */
export interface Report {
  stages: {
    stage: string
    iterations: number
    cost_before: number | null
    cost_after: number | null
    termination: string
    metrics: Record<string, number>
  }[]
  cameras: {
    id: string
    solved: boolean
    n_detections: number
    n_rejected_detections: number
    reprojection_px: Summary | null
    reprojection_mm?: Summary | null
    rejected_keypoints?: number
  }[]
  people: {
    id: number
    /** Given by a correction. */
    name?: string
    first_frame: number
    last_frame: number
    n_detections: number
    reprojection_px: Summary | null
    reprojection_mm?: Summary | null
    share_in_two_views?: number
    sigma_mm?: SigmaSummary | null
    joint_sigma_mm?: SigmaSummary | null
    /** Stretches in which half of the joints are uncertain by more than 80 mm; absent where there are none. */
    uncertain_frames?: { first_frame: number; last_frame: number; joint_sigma_mm: number; cameras: string[] }[]
    /** Of the fitted body; the sigmas include the uncertainty of the scale. */
    body?: {
      stature_m: number
      mass_kg: number
      sigmas: { stature_m: number; mass_kg: number; betas: number[] } | null
    } | null
    ray_angle_deg?: number | null
    dilution?: number | null
    keypoints?: KeypointStatistics[]
    bone_length_spread: number | null
    jitter_m_per_s2: number | null
  }[]
  consistency: { ambiguous_frames: number; pairs: ConsistencyPair[] } | null
  geometry?: { people_spread_m: number | null; ray_angle_deg: number | null; dilution: number | null }
  heldout_px: number | null
  scale: { value: number; interval95: [number, number]; evidence: string } | null
  rejected_detections: number
  keypoints_from: string
  quality: Quality
}

/** Changes of the consistency stage to the detections of one person in one camera. */
export interface ConsistencyPair {
  camera: string
  person: number
  rejected_detections: number
  rejected_joints: number
  flips_undone: number
  swaps_repaired: [number, number][]
}

/** Whether a service has the job; the folder of `wandless view` is shown as a job of the session 0. */
export function isStored(job: Job) {
  return !/^session_0+$/.test(job.session)
}

const FINAL: State[] = ['succeeded', 'failed', 'canceled', 'dead']

/** A final state never changes. */
export function isFinal(state: State) {
  return FINAL.includes(state)
}
