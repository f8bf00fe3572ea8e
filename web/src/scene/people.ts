// People drawn as bodies, skeletons, 3D keypoints and raw 3D points.

import { Color, type Object3D } from 'three'
import type { BodyMesh } from '../data/body_mesh'
import { type Motion, type Person, N_FINGER_BONES, N_JOINTS, forEachFingerBone, keypointEdges, rowAt } from '../data/motion'
import { Bodies } from './bodies'
import type { Lens } from './lens'
import { type SceneColors, personColor } from './palette'
import { RoundCones } from './round_cones'

const BONE_RADIUS = 0.013
const JOINT_RADIUS = 0.024
const FINGER_RADIUS = 0.005
const POINT_RADIUS = 0.024
const EDGE_RADIUS = 0.009

/** Three.js layers; side-by-side pictures draw different layers. */
export const LAYERS = { shared: 0, body: 1, points: 2, raw: 3 }

export interface PeopleLook {
  body: boolean
  skeleton: boolean
  points: boolean
  selected: number | null
  /** Faded, because an overlay is drawn on top. */
  isMuted: boolean
}

export class People {
  /** Null until the mesh is loaded. */
  bodies: Bodies | null = null
  private readonly skeletons: RoundCones
  private readonly points: RoundCones
  private readonly raw: RoundCones
  private readonly edges: [number, number][]
  private readonly color = new Color()
  private readonly tone = new Color()

  constructor(private readonly motion: Motion, private readonly parent: Object3D, private readonly lens: Lens) {
    const n = Math.max(motion.people.length, 1)
    this.edges = keypointEdges(motion.keypoint_names)
    const n_parts = n * (this.edges.length + motion.keypoint_names.length)
    const n_fingers = N_FINGER_BONES * motion.people.filter(({ fingers }) => fingers).length
    this.skeletons = new RoundCones(n * 2 * N_JOINTS + n_fingers, 6, LAYERS.body, lens)
    this.points = new RoundCones(n_parts, 5, LAYERS.points, lens)
    this.raw = new RoundCones(n_parts, 5, LAYERS.raw, lens)
    parent.add(this.skeletons.mesh, this.points.mesh, this.raw.mesh)
  }

  /** Whether the result contains the joint rotations that bodies need. */
  get canHaveBodies() {
    return this.motion.people.every(({ rotations }) => rotations !== null)
  }

  addBodies(mesh: BodyMesh) {
    if (this.canHaveBodies) this.bodies = new Bodies(this.motion, mesh, this.parent, LAYERS.body, this.lens)
  }

  /** Draws all people at a frame index; `raw`: raw 3D points per person. */
  show(frame: number, look: PeopleLook, raw: Float32Array[] | null, colors: SceneColors) {
    const all = [this.skeletons, this.points, this.raw]
    all.forEach((cones) => cones.clear())
    this.bodies?.hide()
    const n = this.motion.keypoint_names.length
    this.motion.people.forEach((person, index) => {
      const row = rowAt(person, frame)
      this.color.set(personColor(index))
      const isOther = look.selected !== null && look.selected !== index
      if (isOther) this.color.lerp(this.tone.set(colors.unobserved), 0.6)
      if (raw) this.addPoints(this.raw, raw[index], 0)
      if (row < 0) return
      if (person.valid[row] === 0) this.color.lerp(this.tone.set(colors.unobserved), 0.75)
      if (look.isMuted) this.color.lerp(this.tone.set(colors.background), 0.55)
      if (look.body && this.bodies) this.bodies.pose(index, person, row, this.color)
      if (look.skeleton || (look.body && !this.bodies)) this.addSkeleton(person, row)
      if (look.points) this.addPoints(this.points, person.keypoints, row * n)
    })
    all.forEach((cones) => cones.show())
  }

  /** Ends of the drawn bones of all skeletons, world metres. */
  get skeletonEnds() {
    return this.skeletons.ends
  }

  private addSkeleton(person: Person, row: number) {
    const at = row * N_JOINTS
    this.motion.joint_parents.forEach((parent, joint) => {
      if (parent !== null) {
        this.skeletons.add(person.joints, at + parent, at + joint, BONE_RADIUS, BONE_RADIUS, this.color)
      }
      this.skeletons.add(person.joints, at + joint, at + joint, JOINT_RADIUS, JOINT_RADIUS, this.color)
    })
    forEachFingerBone(this.motion, person, row, (from, i, to, j) => {
      this.skeletons.put(from[i], from[i + 1], from[i + 2], FINGER_RADIUS, to[j], to[j + 1], to[j + 2], FINGER_RADIUS, this.color)
    })
  }

  private addPoints(cones: RoundCones, points: Float32Array, at: number) {
    for (const [a, b] of this.edges) cones.add(points, at + a, at + b, EDGE_RADIUS, EDGE_RADIUS, this.color)
    for (let k = 0; k < this.motion.keypoint_names.length; k++) {
      cones.add(points, at + k, at + k, POINT_RADIUS, POINT_RADIUS, this.color)
    }
  }

  dispose() {
    for (const part of [this.skeletons, this.points, this.raw, this.bodies]) part?.dispose()
  }
}
