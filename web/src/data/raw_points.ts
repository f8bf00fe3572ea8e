// 3D points from the raw detections: each keypoint is triangulated per frame with the identities before the consistency
// stage.

import { type CameraDetections } from './detections'
import type { Camera, Motion } from './motion'
import { normalizedFromPixel } from './projection'

/** Points below this confidence (of 255) are ignored: the threshold of the solver, 0.3. */
const MIN_CONFIDENCE = 77

/** Points per person, [K, 3], world metres; NaN with fewer than two cameras. */
export function rawPoints(motion: Motion, detections: CameraDetections[], frame: number): Float32Array[] {
  const n = motion.keypoint_names.length
  return motion.people.map(({ id }) => {
    const points = new Float32Array(3 * n).fill(NaN)
    const own = motion.cameras.map((camera, c) => (camera.R ? detectionOf(detections[c], frame, id) : -1))
    for (let k = 0; k < n; k++) {
      const triangulation = new Triangulation()
      own.forEach((d, c) => {
        if (d < 0 || detections[c].confidence[d * n + k] < MIN_CONFIDENCE) return
        const [x, y] = [detections[c].pixels[2 * (d * n + k)], detections[c].pixels[2 * (d * n + k) + 1]]
        if (x === x) triangulation.add(motion.cameras[c], x, y)
      })
      const point = triangulation.point()
      if (point) points.set(point, 3 * k)
    }
    return points
  })
}

/** Index of the detection of a person in a frame; -1 without one. */
function detectionOf(detections: CameraDetections, frame: number, id: number) {
  const assigned = detections.cleaning?.before ?? detections.person
  for (let d = detections.starts[frame]; d < detections.starts[frame + 1]; d++) if (assigned[d] === id) return d
  return -1
}

/** The point with the least squared distance to a set of rays: `sum (I - d d^T) (x - c) = 0`. */
class Triangulation {
  private readonly m = [0, 0, 0, 0, 0, 0] // xx xy xz yy yz zz
  private readonly b = [0, 0, 0]
  private n = 0

  add(camera: Camera, x: number, y: number) {
    const { R, position } = camera
    if (!R || !position) return
    const [u, v] = normalizedFromPixel(camera, x, y)
    const ray = [0, 1, 2].map((i) => R[0][i] * u + R[1][i] * v + R[2][i])
    const length = Math.hypot(...ray)
    const [dx, dy, dz] = ray.map((c) => c / length)
    const p = [1 - dx * dx, -dx * dy, -dx * dz, 1 - dy * dy, -dy * dz, 1 - dz * dz]
    p.forEach((value, i) => (this.m[i] += value))
    const [cx, cy, cz] = position
    this.b[0] += p[0] * cx + p[1] * cy + p[2] * cz
    this.b[1] += p[1] * cx + p[3] * cy + p[4] * cz
    this.b[2] += p[2] * cx + p[4] * cy + p[5] * cz
    this.n++
  }

  point(): [number, number, number] | null {
    const [a, b, c, d, e, f] = this.m
    const [p, q, r] = this.b
    const cofactors = [d * f - e * e, c * e - b * f, b * e - c * d]
    const det = a * cofactors[0] + b * cofactors[1] + c * cofactors[2]
    // Nearly parallel rays do not determine a point.
    if (this.n < 2 || det < 1e-4) return null
    return [
      (cofactors[0] * p + cofactors[1] * q + cofactors[2] * r) / det,
      (cofactors[1] * p + (a * f - c * c) * q + (b * c - a * e) * r) / det,
      (cofactors[2] * p + (b * c - a * e) * q + (a * d - b * b) * r) / det,
    ]
  }
}
