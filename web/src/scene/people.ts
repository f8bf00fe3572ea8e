// People as mannequins, as skeletons and as the detector's points.

import { Color, type Object3D } from 'three'
import { type Motion, type Person, N_JOINTS, keypointEdges, rowAt } from '../data/motion'
import { type Ground, personColor } from './palette'
import { RoundCones } from './round_cones'

/** Parts of a mannequin: SMPL joint at either end and the radius there, m, of an adult with a thigh of `THIGH`. */
const PARTS: [number, number, number, number][] = [
  [1, 2, 0.098, 0.098], // hips
  [0, 3, 0.112, 0.108],
  [3, 6, 0.108, 0.112],
  [6, 9, 0.112, 0.118],
  [9, 12, 0.104, 0.052],
  [9, 16, 0.1, 0.06], // chest to shoulders
  [9, 17, 0.1, 0.06],
  [12, 15, 0.052, 0.056],
  [16, 18, 0.054, 0.043],
  [17, 19, 0.054, 0.043],
  [18, 20, 0.042, 0.029],
  [19, 21, 0.042, 0.029],
  [20, 22, 0.033, 0.026],
  [21, 23, 0.033, 0.026],
  [1, 4, 0.084, 0.056],
  [2, 5, 0.084, 0.056],
  [4, 7, 0.055, 0.036],
  [5, 8, 0.055, 0.036],
  [7, 10, 0.041, 0.032],
  [8, 11, 0.041, 0.032],
]
const THIGH = 0.39
const [NECK, HEAD, LEFT_HIP, LEFT_KNEE] = [12, 15, 1, 4]

/** The skull begins at the head joint and goes on along the neck for so long, m. */
const SKULL = { length: 0.1, base: 0.082, crown: 0.094 }

const BONE_RADIUS = 0.013
const JOINT_RADIUS = 0.024
const POINT_RADIUS = 0.02
const EDGE_RADIUS = 0.006

/** Three.js layers: what is drawn for whom when two pictures stand side by side. */
export const LAYERS = { shared: 0, body: 1, points: 2 }

export interface PeopleLook {
  body: boolean
  skeleton: boolean
  points: boolean
  selected: number | null
  /** Set back behind what is drawn over it. */
  isMuted: boolean
}

export class People {
  readonly bodies: RoundCones
  private readonly skeletons: RoundCones
  private readonly points: RoundCones
  private readonly edges: [number, number][]
  private readonly color = new Color()
  private readonly tone = new Color()

  constructor(private readonly motion: Motion, parent: Object3D) {
    const n = Math.max(motion.people.length, 1)
    this.edges = keypointEdges(motion.keypoint_names)
    this.bodies = new RoundCones(n * (PARTS.length + 1), 10, true)
    this.skeletons = new RoundCones(n * 2 * N_JOINTS, 6, false)
    this.points = new RoundCones(n * (this.edges.length + motion.keypoint_names.length), 6, false)
    this.bodies.mesh.layers.set(LAYERS.body)
    this.skeletons.mesh.layers.set(LAYERS.body)
    this.points.mesh.layers.set(LAYERS.points)
    parent.add(this.bodies.mesh, this.skeletons.mesh, this.points.mesh)
  }

  /** Poses everybody as they are at a frame index. */
  show(frame: number, look: PeopleLook, ground: Ground) {
    const all = [this.bodies, this.skeletons, this.points]
    all.forEach((cones) => cones.clear())
    this.motion.people.forEach((person, index) => {
      const row = rowAt(person, frame)
      if (row < 0) return
      this.color.set(personColor(index))
      const isCarried = person.valid[row] === 0
      const isAside = look.selected !== null && look.selected !== index
      if (isCarried || isAside) this.color.lerp(this.tone.set(ground.carried), isCarried ? 0.75 : 0.6)
      if (look.isMuted) this.color.lerp(this.tone.set(ground.background), 0.62)
      if (look.body) this.addBody(person, row)
      if (look.skeleton) this.addSkeleton(person, row)
      if (look.points) this.addPoints(person, row)
    })
    all.forEach((cones) => cones.show())
  }

  private addBody(person: Person, row: number) {
    const { joints } = person
    const at = row * N_JOINTS
    const scale = distance(joints, at + LEFT_HIP, at + LEFT_KNEE) / THIGH
    for (const [a, b, radiusA, radiusB] of PARTS) {
      this.bodies.add(joints, at + a, at + b, radiusA * scale, radiusB * scale, this.color)
    }
    const [n, h] = [3 * (at + NECK), 3 * (at + HEAD)]
    const reach = (SKULL.length * scale) / Math.max(distance(joints, at + NECK, at + HEAD), 1e-6)
    const crown = (c: number) => joints[h + c] + reach * (joints[h + c] - joints[n + c])
    const [base, top] = [SKULL.base * scale, SKULL.crown * scale]
    this.bodies.put(joints[h], joints[h + 1], joints[h + 2], base, crown(0), crown(1), crown(2), top, this.color)
  }

  private addSkeleton(person: Person, row: number) {
    const at = row * N_JOINTS
    this.motion.joint_parents.forEach((parent, joint) => {
      if (parent !== null) {
        this.skeletons.add(person.joints, at + parent, at + joint, BONE_RADIUS, BONE_RADIUS, this.color)
      }
      this.skeletons.add(person.joints, at + joint, at + joint, JOINT_RADIUS, JOINT_RADIUS, this.color)
    })
  }

  private addPoints(person: Person, row: number) {
    const n = this.motion.keypoint_names.length
    const at = row * n
    for (const [a, b] of this.edges) {
      this.points.add(person.keypoints, at + a, at + b, EDGE_RADIUS, EDGE_RADIUS, this.color)
    }
    for (let k = 0; k < n; k++) {
      this.points.add(person.keypoints, at + k, at + k, POINT_RADIUS, POINT_RADIUS, this.color)
    }
  }

  dispose() {
    for (const cones of [this.bodies, this.skeletons, this.points]) cones.dispose()
  }
}

function distance(points: Float32Array, a: number, b: number) {
  const [i, j] = [3 * a, 3 * b]
  return Math.hypot(points[i] - points[j], points[i + 1] - points[j + 1], points[i + 2] - points[j + 2])
}
