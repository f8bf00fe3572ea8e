// The pinhole camera with OpenCV's five-parameter distortion, as the solver has it. Pixel (0, 0) is the centre of the
// first pixel.

import type { Camera } from './motion'

/** Nearer to the camera's plane than this (m) nothing projects. */
const MIN_DEPTH = 1e-3

/** Where a point of the world (m) is seen (px), written to `pixel`; false behind the camera or for an unknown point. */
export function project(camera: Camera, x: number, y: number, z: number, pixel: [number, number]): boolean {
  const { R, t, K, dist } = camera
  if (!R || !t) return false
  const depth = R[2][0] * x + R[2][1] * y + R[2][2] * z + t[2]
  if (!(depth >= MIN_DEPTH)) return false
  const u = (R[0][0] * x + R[0][1] * y + R[0][2] * z + t[0]) / depth
  const v = (R[1][0] * x + R[1][1] * y + R[1][2] * z + t[1]) / depth
  const [k1, k2, p1, p2, k3] = dist
  const r2 = u * u + v * v
  const radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
  const du = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
  const dv = v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v
  pixel[0] = K[0][0] * du + K[0][1] * dv + K[0][2]
  pixel[1] = K[1][1] * dv + K[1][2]
  return true
}
