// Independent implementation of OpenCV's camera models, and a simulated take with lens distortion.

import { readFileSync, writeFileSync } from 'node:fs'
import { join } from 'node:path'

/** Lenses of the first cameras of a take, in order; the other cameras keep their lens. */
export const LENSES = [
  { dist: [-0.28, 0.09, 0.0012, -0.0008, -0.012] },
  { dist: [0.35, -0.12, 0.0006, 0.0009, 0.01, 0.62, -0.05, 0.008], distortion_model: 'rational' },
  { dist: [-0.031, 0.012, -0.006, 0.001], distortion_model: 'fisheye' },
]

/** Distorts normalised coordinates. */
function distorted({ dist, distortion_model }, [a, b]) {
  if (distortion_model === 'fisheye') {
    const r = Math.hypot(a, b)
    const theta = Math.atan(r)
    const [k1, k2, k3, k4] = dist
    const distortedRadius = theta + k1 * theta ** 3 + k2 * theta ** 5 + k3 * theta ** 7 + k4 * theta ** 9
    return r === 0 ? [a, b] : [(a / r) * distortedRadius, (b / r) * distortedRadius]
  }
  const [k1, k2, p1, p2, k3 = 0, k4 = 0, k5 = 0, k6 = 0] = dist
  const s = a * a + b * b
  const scale = (1 + k1 * s + k2 * s ** 2 + k3 * s ** 3) / (1 + k4 * s + k5 * s ** 2 + k6 * s ** 3)
  return [a * scale + 2 * p1 * a * b + p2 * (s + 2 * a * a), b * scale + p1 * (s + 2 * b * b) + 2 * p2 * a * b]
}

const pixelOf = (K, [u, v]) => [K[0][0] * u + K[0][1] * v + K[0][2], K[1][1] * v + K[1][2]]

/** Projects a world point with a camera of `cameras.json`, with and without distortion; null behind the camera. */
export function projected(camera, point) {
  const { K, R, t } = camera
  const [x, y, z] = R.map((row, i) => row[0] * point[0] + row[1] * point[1] + row[2] * point[2] + t[i])
  if (z < 1e-3) return null
  const ideal = [x / z, y / z]
  return { distorted: pixelOf(K, distorted(camera, ideal)), pinhole: pixelOf(K, ideal) }
}

/** Applies the lenses to the keypoints of a simulated session with ideal cameras. */
export function throughLenses(folder) {
  const path = join(folder, 'session.json')
  const session = JSON.parse(readFileSync(path, 'utf8'))
  LENSES.forEach((lens, i) => {
    const camera = Object.assign(session.cameras[i], lens)
    const file = join(folder, 'poses', `${camera.id}.json`)
    const poses = JSON.parse(readFileSync(file, 'utf8'))
    for (const { keypoints } of poses.frames.flatMap(({ people }) => people)) {
      for (const keypoint of keypoints) {
        const v = (keypoint[1] - camera.K[1][2]) / camera.K[1][1]
        const u = (keypoint[0] - camera.K[0][2] - camera.K[0][1] * v) / camera.K[0][0]
        ;[keypoint[0], keypoint[1]] = pixelOf(camera.K, distorted(camera, [u, v]))
      }
    }
    writeFileSync(file, JSON.stringify(poses))
  })
  writeFileSync(path, JSON.stringify(session))
  return folder
}
