// Pinhole camera with OpenCV distortion (five and eight coefficients, fisheye), as in the solver. Pixel (0, 0) is the
// centre of the first pixel.

import type { Camera } from './motion'

/** Smallest depth of points that are projected, m. */
const MIN_DEPTH = 1e-3

/** Projects a world point (m) and writes `pixel` (px); false behind the camera and for unknown points. */
export function project(camera: Camera, x: number, y: number, z: number, pixel: [number, number]): boolean {
  const { R, t } = camera
  if (!R || !t) return false
  const depth = R[2][0] * x + R[2][1] * y + R[2][2] * z + t[2]
  if (!(depth >= MIN_DEPTH)) return false
  const u = (R[0][0] * x + R[0][1] * y + R[0][2] * z + t[0]) / depth
  const v = (R[1][0] * x + R[1][1] * y + R[1][2] * z + t[1]) / depth
  pixelFromNormalized(camera, u, v, pixel)
  return true
}

/** Writes the pixel of undistorted normalised coordinates to `pixel`. */
export function pixelFromNormalized(camera: Camera, u: number, v: number, pixel: [number, number]) {
  distort(camera, u, v, pixel)
  const { K } = camera
  const [du, dv] = pixel
  pixel[0] = K[0][0] * du + K[0][1] * dv + K[0][2]
  pixel[1] = K[1][1] * dv + K[1][2]
}

/** Whether the lens has any distortion. */
export function isDistorted({ dist }: Camera) {
  return dist.some((k) => k !== 0)
}

/** Distorts normalised coordinates. */
function distort({ dist, distortion_model }: Camera, u: number, v: number, distorted: [number, number]) {
  const r2 = u * u + v * v
  if (distortion_model === 'fisheye') {
    const r = Math.sqrt(r2)
    const theta = Math.atan(r)
    const s = theta * theta
    const factor = 1 + s * (dist[0] + s * (dist[1] + s * (dist[2] + s * dist[3])))
    const scale = r > 1e-9 ? (theta * factor) / r : 1
    distorted[0] = scale * u
    distorted[1] = scale * v
    return
  }
  const [k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0, k4 = 0, k5 = 0, k6 = 0] = dist
  const radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
  distorted[0] = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
  distorted[1] = v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v
}

/** Largest angle to the optical axis in the inverse of the fisheye model, rad. */
const MAX_ANGLE = 1.55

/** Undistorted normalised coordinates of a pixel; approximate where the distortion is not invertible. */
export function normalizedFromPixel(camera: Camera, x: number, y: number): [number, number] {
  const { K } = camera
  const v = (y - K[1][2]) / K[1][1]
  const u = (x - K[0][2] - K[0][1] * v) / K[0][0]
  if (!isDistorted(camera)) return [u, v]
  const [guess, distorted]: [number, number][] = [startOf(camera, u, v), [0, 0]]
  // Secant steps: distortion is nearly a scaling, so that each step gains at least two digits.
  for (let i = 0; i < 12; i++) {
    distort(camera, guess[0], guess[1], distorted)
    const [du, dv] = [u - distorted[0], v - distorted[1]]
    if (Math.abs(du) + Math.abs(dv) < 1e-9) break
    const step = slope(camera, guess, distorted)
    guess[0] += du / step
    guess[1] += dv / step
  }
  return guess
}

function startOf({ distortion_model }: Camera, u: number, v: number): [number, number] {
  const angle = Math.hypot(u, v)
  if (distortion_model !== 'fisheye' || angle < 1e-9) return [u, v]
  const scale = Math.tan(Math.min(angle, MAX_ANGLE)) / angle
  return [scale * u, scale * v]
}

/** Derivative of the distorted radius by the undistorted one, at least 0.05. */
function slope(camera: Camera, [u, v]: [number, number], [bu, bv]: [number, number]) {
  const r = Math.hypot(u, v)
  if (r < 1e-6) return 1
  const h = 1e-5
  const ahead: [number, number] = [0, 0]
  distort(camera, u * (1 + h), v * (1 + h), ahead)
  return Math.max(Math.hypot(ahead[0] - bu, ahead[1] - bv) / (h * r), 0.05)
}
