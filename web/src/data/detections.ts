// What each camera's detector saw and whom it was given to, from `stages/detections.bin`.

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
}

type Names = 'starts' | 'person' | 'pixels' | 'confidence'

/** By camera, in the session's order. */
export function readDetections(bytes: ArrayBuffer): CameraDetections[] {
  const file = new Described<{ cameras: Record<Names, ArrayRef>[] }>(bytes, 'wandless.detections')
  return file.header.cameras.map((camera) => ({
    starts: file.u32(camera.starts),
    person: file.i16(camera.person),
    pixels: file.f32(camera.pixels),
    confidence: file.u8(camera.confidence),
  }))
}
