// Detections of each camera with their persons and the changes of the consistency stage, from `stages/detections.bin`.

import { type ArrayRef, Described } from './described'

export interface CameraDetections {
  /** Detections `starts[f]` to `starts[f + 1]` are those of frame index f. */
  starts: Uint32Array
  /** Person of each detection; -1: not assigned. */
  person: Int16Array
  /** [detections, K, 2], px; NaN for missing points. */
  pixels: Float32Array
  /** [detections, K]: 0 to 255. */
  confidence: Uint8Array
  /** Changes of the consistency stage; null if it was switched off. */
  cleaning: Cleaning | null
}

export interface Cleaning {
  /** Person of each detection before the stage; -1: not assigned. */
  before: Int16Array
  /** Row of `sources` for each detection whose keypoints were exchanged or rejected. */
  rows: Map<number, number>
  /** [rows, K]: index of the detected keypoint that is used for each keypoint; `REJECTED` for none. */
  sources: Uint8Array
}

const REJECTED = 255

type Names = 'starts' | 'person' | 'pixels' | 'confidence'
type CleaningNames = 'before' | 'repaired' | 'sources'
type Header = { cameras: (Record<Names, ArrayRef> & Partial<Record<CleaningNames, ArrayRef>>)[] }

/** Reads the detections per camera, in the order of the session. */
export function readDetections(bytes: ArrayBuffer): CameraDetections[] {
  const file = new Described<Header>(bytes, 'wandless.detections')
  return file.header.cameras.map(({ before, repaired, sources, ...camera }) => ({
    starts: file.u32(camera.starts),
    person: file.i16(camera.person),
    pixels: file.f32(camera.pixels),
    confidence: file.u8(camera.confidence),
    cleaning: before && repaired && sources
      ? {
          before: file.i16(before),
          rows: new Map(Array.from(file.u32(repaired), (detection, row) => [detection, row])),
          sources: file.u8(sources),
        }
      : null,
  }))
}

/** Index of the detected keypoint that is used for keypoint `k` after cleaning; -1 if it was rejected. */
export function sourceOf({ cleaning }: CameraDetections, detection: number, k: number, n_keypoints: number) {
  const row = cleaning?.rows.get(detection)
  if (!cleaning || row === undefined) return k
  const source = cleaning.sources[row * n_keypoints + k]
  return source === REJECTED ? -1 : source
}

/** Describes the changes to one detection in a few words; empty without changes. */
export function changesOf(detections: CameraDetections, detection: number, n_keypoints: number): string {
  const { cleaning, person } = detections
  if (!cleaning) return ''
  const changes: string[] = []
  const before = cleaning.before[detection]
  if (before >= 0 && before !== person[detection]) changes.push(`was person ${before}`)
  if (cleaning.rows.has(detection)) {
    let [exchanged, rejected] = [0, 0]
    for (let k = 0; k < n_keypoints; k++) {
      const source = sourceOf(detections, detection, k, n_keypoints)
      if (source < 0) rejected++
      else if (source !== k) exchanged++
    }
    if (exchanged) changes.push('left and right exchanged')
    if (rejected) changes.push(rejected === 1 ? '1 joint rejected' : `${rejected} joints rejected`)
  }
  return changes.join(', ')
}
