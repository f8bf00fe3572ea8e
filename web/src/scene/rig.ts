// Cameras of a result, drawn as frusta, and the view through a camera.

import {
  BufferGeometry,
  Float32BufferAttribute,
  LineBasicMaterial,
  LineSegments,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  type Object3D,
  type PerspectiveCamera,
  SphereGeometry,
  Vector3,
} from 'three'
import type { Camera } from '../data/motion'
import type { Lens } from './lens'
import type { SceneColors } from './palette'

/** Depth of a frustum, m. */
const DEPTH = 0.45

/** Radius of the sphere at a camera in standard deviations of its position, which is only a few millimetres. */
export const SIGMA_SCALE = 20

/** Minimum radius of that sphere, m; also used for cameras of unknown uncertainty. */
const MIN_RADIUS = 0.025

const [NEAR, FAR] = [0.05, 200]

export class Rig {
  private readonly items: { index: number; lines: LineSegments; sphere: Mesh }[]

  constructor(readonly cameras: Camera[], parent: Object3D, lens: Lens) {
    this.items = cameras.flatMap((camera, index) => {
      const pose = worldFromCamera(camera)
      if (!pose) return []
      const lines = new LineSegments(frustum(camera), new LineBasicMaterial({ transparent: true }))
      const radius = Math.max(MIN_RADIUS, (SIGMA_SCALE * (camera.sigma_position_mm ?? 0)) / 1000)
      const sphere = new Mesh(new SphereGeometry(radius, 20, 14), new MeshBasicMaterial({ transparent: true }))
      for (const object of [lines, sphere]) {
        lens.applyTo(object.material as LineBasicMaterial | MeshBasicMaterial)
        object.matrixAutoUpdate = false
        object.matrix.copy(pose)
        parent.add(object)
      }
      return [{ index, lines, sphere }]
    })
  }

  show(isShown: boolean, selected: number | null, through: number | null, colors: SceneColors) {
    for (const { index, lines, sphere } of this.items) {
      lines.visible = sphere.visible = isShown && index !== through
      const material = lines.material as LineBasicMaterial
      material.color.set(index === selected ? colors.accent : colors.line)
      material.opacity = index === selected ? 1 : 0.8
      const fill = sphere.material as MeshBasicMaterial
      fill.color.set(colors.accent)
      fill.opacity = index === selected ? 0.75 : 0.35
    }
  }

  dispose() {
    for (const mesh of this.items.flatMap(({ lines, sphere }) => [lines, sphere])) {
      mesh.geometry.dispose()
      ;(mesh.material as LineBasicMaterial | MeshBasicMaterial).dispose()
    }
  }
}

/** `world_from_camera` with OpenCV camera axes; null for a camera that was not solved. */
export function worldFromCamera({ R, t, position }: Camera): Matrix4 | null {
  if (!R || !t || !position) return null
  const [x, y, z] = position
  return new Matrix4().set(
    R[0][0], R[1][0], R[2][0], x,
    R[0][1], R[1][1], R[2][1], y,
    R[0][2], R[1][2], R[2][2], z,
    0, 0, 0, 1,
  )
}

/** Lines of a frustum: four edges, the image border and a mark at its top. */
function frustum({ K, width, height }: Camera) {
  const corner = (u: number, v: number) =>
    new Vector3(((u - K[0][2]) / K[0][0]) * DEPTH, ((v - K[1][2]) / K[1][1]) * DEPTH, DEPTH)
  const [a, b, c, d] = [corner(0, 0), corner(width, 0), corner(width, height), corner(0, height)]
  const [left, top, right] = [corner(0.38 * width, 0), corner(0.5 * width, -0.22 * height), corner(0.62 * width, 0)]
  const apex = new Vector3()
  const ends = [apex, a, apex, b, apex, c, apex, d, a, b, b, c, c, d, d, a, left, top, top, right]
  return new BufferGeometry().setAttribute('position', new Float32BufferAttribute(ends.flatMap((p) => p.toArray()), 3))
}

/** From the camera axes of three.js (y up, looking along -z) to those of OpenCV. */
const FLIP = new Matrix4().makeScale(1, -1, -1)

/** Sets `view` to the pose and intrinsics of a camera, without lens distortion. */
export function lookThrough(view: PerspectiveCamera, camera: Camera, threeFromWorld: Matrix4) {
  const pose = worldFromCamera(camera)
  if (!pose) return
  view.matrixAutoUpdate = false
  view.matrix.copy(threeFromWorld).multiply(pose).multiply(FLIP)
  view.matrixWorldNeedsUpdate = true
  view.updateMatrixWorld(true)
  const { K, width, height } = camera
  // Pixel (0, 0) is the centre of the first pixel: the image reaches from -0.5 to width - 0.5.
  const left = (NEAR * (-0.5 - K[0][2])) / K[0][0]
  const top = (NEAR * (0.5 + K[1][2])) / K[1][1]
  const right = left + (NEAR * width) / K[0][0]
  const bottom = top - (NEAR * height) / K[1][1]
  view.projectionMatrix.makePerspective(left, right, top, bottom, NEAR, FAR)
  view.projectionMatrix.elements[4] -= (2 * K[0][1]) / width
  view.projectionMatrixInverse.copy(view.projectionMatrix).invert()
}
