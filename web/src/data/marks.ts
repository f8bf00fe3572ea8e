// Marks on the time line: frames with repaired identities and repaired or rejected detections.

import type { Motion } from './motion'

/** Marks closer than this to the previous frame with a mark are skipped, frames. */
const MIN_DISTANCE = 5

/** The nearest mark before (-1) or after (1) a frame, of one camera or of all; the frame itself if there are no more marks. */
export function nextMark(motion: Motion, camera: number | null, frame: number, by: number) {
  const marks = marksOf(motion, camera)
  const found = by > 0 ? marks.find((mark) => mark > frame) : marks.findLast((mark) => mark < frame)
  return found ?? frame
}

function marksOf(motion: Motion, camera: number | null) {
  const ofCamera = motion.people.flatMap(({ repairs }) => repairs.filter(([, c]) => camera === null || c === camera))
  const marked = new Set(ofCamera.map(([frame]) => frame))
  for (let frame = 0; frame < motion.n_frames; frame++) {
    if (countAt(motion, motion.rejected, frame, camera) + countAt(motion, motion.repaired, frame, camera)) marked.add(frame)
  }
  const inOrder = [...marked].sort((a, b) => a - b)
  return inOrder.filter((frame, i) => i === 0 || frame - inOrder[i - 1] > MIN_DISTANCE)
}

/** Counted detections of a frame in one camera, or in all cameras. */
export function countAt({ cameras, n_frames }: Motion, counts: Uint8Array | null, frame: number, camera: number | null = null) {
  if (!counts) return 0
  if (camera !== null) return counts[camera * n_frames + frame]
  let n = 0
  for (let c = 0; c < cameras.length; c++) n += counts[c * n_frames + frame]
  return n
}
