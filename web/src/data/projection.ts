// The pinhole camera with OpenCV's polynomial, rational and fisheye lenses, as the solver has it. Pixel (0, 0) is the centre of the
// first pixel.

import type { Camera } from './motion'

/** Nearer to the camera's plane than this (m) nothing projects. */
const MIN_DEPTH = 1e-3

/** Where a point of the world (m) is seen (px), written to `pixel`; false behind the camera or for an unknown point. */
export function project(camera: Camera, x: number, y: number, z: number, pixel: [number, number]): boolean {
  const { R, t, K } = camera
  if (!R || !t) return false
  const depth = R[2][0] * x + R[2][1] * y + R[2][2] * z + t[2]
  if (!(depth >= MIN_DEPTH)) return false
  const u = (R[0][0] * x + R[0][1] * y + R[0][2] * z + t[0]) / depth
  const v = (R[1][0] * x + R[1][1] * y + R[1][2] * z + t[1]) / depth
  const [du, dv] = bent(camera, u, v)
  pixel[0] = K[0][0] * du + K[0][1] * dv + K[0][2]
  pixel[1] = K[1][1] * dv + K[1][2]
  return true
}

/** What the lens makes of ideal normalised coordinates; the coefficients stand in OpenCV's order. */
function bent({ dist, distortion_model: model }: Camera, u: number, v: number): [number, number] {
  const r2 = u * u + v * v
  if (model === 'fisheye') {
    const [k1, k2, k3, k4] = dist
    const r = Math.sqrt(r2)
    const angle = Math.atan(r)
    const a2 = angle * angle
    const scale = r > 1e-9 ? (angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))) / r : 1
    return [u * scale, v * scale]
  }
  const [k1, k2, p1, p2, k3, k4 = 0, k5 = 0, k6 = 0] = dist
  const radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
  return [
    u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u),
    v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v,
  ]
}
