// The stage: floor, lights, the free view and the views through cameras.

import {
  AmbientLight,
  Box3,
  DirectionalLight,
  Fog,
  GridHelper,
  Group,
  HemisphereLight,
  type LineBasicMaterial,
  Mesh,
  PerspectiveCamera,
  PlaneGeometry,
  Scene,
  ShadowMaterial,
  Vector3,
  type WebGLRenderer,
} from 'three'
import { OrbitControls } from 'three/addons/controls/OrbitControls.js'
import { type Camera, type Motion, N_JOINTS } from '../data/motion'
import { isDistorted } from '../data/projection'
import { type SceneColors, sceneColors } from './palette'
import { Lens } from './lens'
import { lookThrough } from './rig'
import { type Surface, closeSurface } from './surface'

/** A rectangle of the canvas, CSS pixels from its upper left. */
export interface Rectangle {
  left: number
  top: number
  width: number
  height: number
}

/** Side of the floor grid, m. */
const FLOOR = 40

/** Aspect ratio below which the free view zooms out. */
const NARROW = 1.05

export class Stage {
  readonly canvas: HTMLCanvasElement
  /** Objects in the world of the result; rotated if its z axis is up. */
  readonly world = new Group()
  readonly free: PerspectiveCamera
  readonly lens = new Lens()
  colors: SceneColors = sceneColors()
  private readonly through = new PerspectiveCamera()
  private readonly scene = new Scene()
  private readonly renderer: WebGLRenderer
  private readonly controls: OrbitControls
  private readonly sun = new DirectionalLight('#ffffff', 2.1)
  private grids: GridHelper[] = []
  private readonly floor = shadowCatcher()
  private readonly centre: Vector3
  private readonly reach: number

  /** `onchange` is called when the free view has moved. */
  constructor(motion: Motion, private readonly surface: Surface, onchange: () => void) {
    this.renderer = surface.renderer
    this.canvas = this.renderer.domElement
    this.canvas.tabIndex = 0
    this.canvas.setAttribute('role', 'img')
    this.canvas.setAttribute('aria-label', '3D scene: drag to rotate, scroll to zoom.')

    if (motion.up_axis === 'z') this.world.rotation.x = -Math.PI / 2
    this.world.updateMatrixWorld(true)
    const bounds = boundsOf(motion, this.world)
    this.centre = bounds.getCenter(new Vector3()).setY(0.9)
    this.reach = Math.max(bounds.getSize(new Vector3()).length() / 2, 2)

    this.free = new PerspectiveCamera(42, 1, 0.05, 200)
    this.free.layers.enableAll()
    this.controls = new OrbitControls(this.free, this.canvas)
    this.controls.maxPolarAngle = 0.495 * Math.PI
    this.controls.maxDistance = 60
    this.controls.addEventListener('change', onchange)
    this.resetView()
    this.scene.add(this.world, ...this.lights(), this.floor)
    this.repaint()
  }

  private lights() {
    this.sun.position.copy(this.centre).add(new Vector3(3, 8, 4))
    this.sun.target.position.copy(this.centre)
    this.sun.castShadow = true
    this.sun.shadow.mapSize.set(1024, 1024)
    const { camera } = this.sun.shadow
    const half = Math.min(this.reach, 8)
    Object.assign(camera, { left: -half, right: half, top: half, bottom: -half, near: 1, far: 24 })
    this.sun.shadow.radius = 4
    this.sun.shadow.bias = -0.0008
    return [this.sun, this.sun.target, new HemisphereLight('#dfe9ff', '#5a5148', 1.3), new AmbientLight('#ffffff', 0.35)]
  }

  /** Applies the colours of the current theme. */
  repaint() {
    this.colors = sceneColors()
    this.renderer.setClearColor(this.colors.background)
    this.scene.fog = new Fog(this.colors.background, 2.2 * this.reach + 4, 5 * this.reach + 14)
    for (const grid of this.grids) this.scene.remove(grid), grid.dispose()
    this.grids = [
      new GridHelper(FLOOR, 2 * FLOOR, this.colors.grid, this.colors.grid),
      new GridHelper(FLOOR, FLOOR / 5, this.colors.gridStrong, this.colors.gridStrong),
    ]
    this.grids.forEach((grid, i) => {
      grid.position.y = -0.002 + 0.001 * i
      ;(grid.material as LineBasicMaterial).depthWrite = false
      this.scene.add(grid)
    })
  }

  /** Resets the free view to show all people and cameras. */
  resetView() {
    this.controls.target.copy(this.centre)
    const distance = 1.6 * this.reach
    this.free.position.copy(this.centre).add(new Vector3(0.55, 0.5, 0.8).normalize().multiplyScalar(distance))
    this.controls.update()
  }

  /** Rotates the free view about its centre (rad) and scales its distance by `closer`. */
  orbit(azimuth: number, polar: number, closer: number) {
    const arm = this.free.position.clone().sub(this.controls.target)
    const length = arm.length() * closer
    const angle = Math.atan2(arm.x, arm.z) + azimuth
    const height = Math.min(Math.max(Math.acos(arm.y / arm.length()) + polar, 0.05), 0.49 * Math.PI)
    arm.setFromSphericalCoords(length, height, angle)
    this.free.position.copy(this.controls.target).add(arm)
    this.controls.update()
  }

  /** Centres the free view on a point of the three.js world. */
  lookAt(point: Vector3) {
    const shift = point.clone().sub(this.controls.target)
    this.controls.target.add(shift)
    this.free.position.add(shift)
    this.controls.update()
  }

  resize(width: number, height: number) {
    this.renderer.setSize(width, height, false)
  }

  /** Draws the free view into a rectangle of the canvas. */
  drawFree(part: Rectangle, layers: number[]) {
    this.controls.enabled = true
    this.free.aspect = part.width / part.height
    // A narrow picture zooms out to keep the horizontal extent.
    this.free.zoom = Math.min(1, this.free.aspect / NARROW)
    this.free.updateProjectionMatrix()
    this.lens.set(null)
    this.draw(part, this.free, layers, true)
  }

  /** Draws the view through a camera into a rectangle with the aspect ratio of its image. */
  drawThrough(part: Rectangle, camera: Camera, layers: number[]) {
    this.controls.enabled = false
    lookThrough(this.through, camera, this.world.matrixWorld)
    this.lens.set(camera)
    // The floor grid is hidden, because distortion of its vertices alone would leave its long lines straight.
    this.draw(part, this.through, layers, !isDistorted(camera))
  }

  /** Undistorted image pixel at which the picture through the camera shows a world point. */
  pixelThrough(camera: Camera, point: [number, number, number]): [number, number] {
    lookThrough(this.through, camera, this.world.matrixWorld)
    const seen = new Vector3(...point).applyMatrix4(this.world.matrixWorld)
    seen.applyMatrix4(this.through.matrixWorldInverse).applyMatrix4(this.through.projectionMatrix)
    return [((seen.x + 1) / 2) * camera.width - 0.5, ((1 - seen.y) / 2) * camera.height - 0.5]
  }

  clear() {
    this.renderer.setScissorTest(false)
    this.renderer.clear()
    this.renderer.setScissorTest(true)
  }

  private draw(part: Rectangle, camera: PerspectiveCamera, layers: number[], hasFloor: boolean) {
    for (const grid of this.grids) grid.visible = hasFloor
    this.floor.visible = hasFloor && !this.surface.isSlow
    camera.layers.disableAll()
    for (const layer of layers) camera.layers.enable(layer)
    const bottom = this.canvas.clientHeight - part.top - part.height
    this.renderer.setViewport(part.left, bottom, part.width, part.height)
    this.renderer.setScissor(part.left, bottom, part.width, part.height)
    this.renderer.render(this.scene, camera)
  }

  /** GPU resources in use. Used by the browser checks. */
  get memory() {
    return { ...this.renderer.info.memory, programs: this.renderer.info.programs?.length ?? 0 }
  }

  dispose() {
    this.controls.dispose()
    for (const grid of this.grids) grid.dispose()
    this.floor.geometry.dispose()
    ;(this.floor.material as ShadowMaterial).dispose()
    closeSurface(this.surface)
  }
}

/** Floor that shows shadows only. */
function shadowCatcher() {
  const floor = new Mesh(new PlaneGeometry(FLOOR, FLOOR), new ShadowMaterial({ opacity: 0.32 }))
  floor.rotation.x = -Math.PI / 2
  floor.position.y = 0.001
  floor.receiveShadow = true
  return floor
}

function boundsOf(motion: Motion, world: Group) {
  const bounds = new Box3()
  const grow = (x: number, y: number, z: number) =>
    bounds.expandByPoint(new Vector3(x, y, z).applyMatrix4(world.matrixWorld))
  for (const { position } of motion.cameras) if (position) grow(position[0], position[1], position[2])
  for (const { joints, n_frames } of motion.people) {
    for (let row = 0; row < n_frames; row += 10) {
      const i = 3 * N_JOINTS * row
      grow(joints[i], joints[i + 1], joints[i + 2])
    }
  }
  if (bounds.isEmpty()) bounds.set(new Vector3(-2, 0, -2), new Vector3(2, 2, 2))
  return bounds
}
