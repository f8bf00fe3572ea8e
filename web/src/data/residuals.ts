// Reprojection errors and accelerations over time.

import { type CameraDetections, sourceOf } from './detections'
import { type Motion, rowAt } from './motion'
import { project } from './projection'

/** Points below this confidence (of 255) are ignored: the threshold of the solver, 0.3. */
const MIN_CONFIDENCE = 77

/** Median reprojection error per camera and frame, px; NaN without observations. */
export function residualsOverTime(motion: Motion, detections: CameraDetections[]): Float32Array[] {
  return motion.cameras.map((camera, c) => {
    const medians = new Float32Array(motion.n_frames).fill(NaN)
    const pixel: [number, number] = [0, 0]
    for (let frame = 0; frame < motion.n_frames && camera.R; frame++) {
      const distances: number[] = []
      eachMatch(motion, detections[c], frame, (x, y, z, u, v) => {
        if (project(camera, x, y, z, pixel)) distances.push(Math.hypot(pixel[0] - u, pixel[1] - v))
      })
      if (distances.length) medians[frame] = median(distances)
    }
    return medians
  })
}

/** Visits every observation of a frame: 3D keypoint (x, y, z) and detected pixel (u, v). */
function eachMatch(
  motion: Motion,
  detections: CameraDetections,
  frame: number,
  visit: (x: number, y: number, z: number, u: number, v: number) => void,
) {
  const n = motion.keypoint_names.length
  for (let d = detections.starts[frame]; d < detections.starts[frame + 1]; d++) {
    const person = motion.people.find((one) => one.id === detections.person[d])
    const row = person ? rowAt(person, frame) : -1
    if (!person || row < 0) continue
    for (let k = 0; k < n; k++) {
      const source = sourceOf(detections, d, k, n)
      if (source < 0 || detections.confidence[d * n + source] < MIN_CONFIDENCE) continue
      const [p, q] = [3 * (row * n + k), 2 * (d * n + source)]
      const x = person.keypoints[p]
      if (x === x) visit(x, person.keypoints[p + 1], person.keypoints[p + 2], detections.pixels[q], detections.pixels[q + 1])
    }
  }
}

/** Mean joint acceleration per person and frame, m/s^2; NaN where the person is absent. */
export function accelerationOverTime(motion: Motion): Float32Array[] {
  return motion.people.map((person) => {
    const rows = new Float32Array(motion.n_frames).fill(NaN)
    const width = person.joints.length / person.n_frames
    for (let row = 1; row + 1 < person.n_frames; row++) {
      let sum = 0
      for (let i = row * width; i < (row + 1) * width; i += 3) {
        const second = (c: number) =>
          person.joints[i + c - width] - 2 * person.joints[i + c] + person.joints[i + c + width]
        sum += Math.hypot(second(0), second(1), second(2))
      }
      rows[person.first + row] = (sum / (width / 3)) * motion.fps * motion.fps
    }
    return rows
  })
}

export function median(values: number[]) {
  values.sort((a, b) => a - b)
  const middle = values.length >> 1
  return values.length % 2 ? values[middle] : (values[middle - 1] + values[middle]) / 2
}
