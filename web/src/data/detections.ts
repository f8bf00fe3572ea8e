// What each camera's detector saw, what the consistency stage made of it and whom it was given to, from
// `stages/detections.bin`.

import { type ArrayRef, Described } from './described'

export interface CameraDetections {
  /** Detections `starts[f]` to `starts[f + 1]` are those of frame index f. */
  starts: Uint32Array
  /** Whom each was given to; -1 for nobody. */
  person: Int16Array
  /** [detections, K, 2], px, NaN where the detector gave no point. */
  pixels: Float32Array
  /** [detections, K]: 0 to 255. */
  confidence: Uint8Array
  /** What was done to them; null where nothing was cleaned. */
  cleaning: Cleaning | null
}

export interface Cleaning {
  /** Whom each had been given to before; -1 for nobody. */
  before: Int16Array
  /** Row of `sources` for each detection whose keypoints were exchanged or rejected. */
  rows: Map<number, number>
  /** [rows, K]: the detected keypoint that shows each, `REJECTED` for none. */
  sources: Uint8Array
}

const REJECTED = 255

type Names = 'starts' | 'person' | 'pixels' | 'confidence'
type CleaningNames = 'before' | 'repaired' | 'sources'
type Header = { cameras: (Record<Names, ArrayRef> & Partial<Record<CleaningNames, ArrayRef>>)[] }

/** By camera, in the session's order. */
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

/** The detected keypoint that shows keypoint `k` of a detection after cleaning; -1 where it was rejected. */
export function sourceOf({ cleaning }: CameraDetections, detection: number, k: number, n_keypoints: number) {
  const row = cleaning?.rows.get(detection)
  if (!cleaning || row === undefined) return k
  const source = cleaning.sources[row * n_keypoints + k]
  return source === REJECTED ? -1 : source
}

/** What was done to one detection, in a few words; empty where nothing was. */
export function deedsOn(seen: CameraDetections, detection: number, n_keypoints: number): string {
  const { cleaning, person } = seen
  if (!cleaning) return ''
  const said: string[] = []
  const before = cleaning.before[detection]
  if (before >= 0 && before !== person[detection]) said.push(`was person ${before}`)
  if (cleaning.rows.has(detection)) {
    let [exchanged, rejected] = [0, 0]
    for (let k = 0; k < n_keypoints; k++) {
      const source = sourceOf(seen, detection, k, n_keypoints)
      if (source < 0) rejected++
      else if (source !== k) exchanged++
    }
    if (exchanged) said.push('left and right exchanged')
    if (rejected) said.push(rejected === 1 ? '1 joint rejected' : `${rejected} joints rejected`)
  }
  return said.join(', ')
}
