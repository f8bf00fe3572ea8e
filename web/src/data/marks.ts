// Where something happened on the time line: identities repaired, detections mended or rejected.

import type { Motion } from './motion'

/** Marks nearer to each other than this are one for whoever goes from mark to mark, frames. */
const APART = 5

/** The nearest mark before (-1) or after (1) a frame, of one camera or of all; the frame itself where there is none. */
export function nextMark(motion: Motion, camera: number | null, frame: number, by: number) {
  const marks = marksOf(motion, camera)
  const found = by > 0 ? marks.find((mark) => mark > frame) : marks.findLast((mark) => mark < frame)
  return found ?? frame
}

function marksOf(motion: Motion, camera: number | null) {
  const ofCamera = motion.people.flatMap(({ repairs }) => repairs.filter(([, c]) => camera === null || c === camera))
  const marked = new Set(ofCamera.map(([frame]) => frame))
  for (let frame = 0; frame < motion.n_frames; frame++) {
    if (countAt(motion, motion.rejected, frame, camera) + countAt(motion, motion.mended, frame, camera)) marked.add(frame)
  }
  const inOrder = [...marked].sort((a, b) => a - b)
  return inOrder.filter((frame, i) => i === 0 || frame - inOrder[i - 1] > APART)
}

/** Detections of a frame that were counted in one camera, or in all together. */
export function countAt({ cameras, n_frames }: Motion, counts: Uint8Array | null, frame: number, camera: number | null = null) {
  if (!counts) return 0
  if (camera !== null) return counts[camera * n_frames + frame]
  let n = 0
  for (let c = 0; c < cameras.length; c++) n += counts[c * n_frames + frame]
  return n
}
