// Selection by a click in the scene.

import { Vector3 } from 'three'
import { type Motion, N_JOINTS, rowAt } from '../data/motion'

/** Largest distance of a click to the selected joint or camera, CSS pixels. */
const MAX_DISTANCE = 28

/** The person or camera nearest to a screen point; `screenOf` projects a world point to the screen. */
export function pick(
  motion: Motion,
  frame: number,
  hasCameras: boolean,
  screenOf: (point: Vector3) => [number, number] | null,
  x: number,
  y: number,
) {
  const point = new Vector3()
  let [nearest, person, camera] = [MAX_DISTANCE, null as number | null, null as number | null]
  const offer = (chosenPerson: number | null, chosenCamera: number | null) => {
    const seen = screenOf(point)
    const distance = seen ? Math.hypot(seen[0] - x, seen[1] - y) : Infinity
    if (distance < nearest) [nearest, person, camera] = [distance, chosenPerson, chosenCamera]
  }
  motion.people.forEach((one, index) => {
    const row = rowAt(one, frame)
    for (let joint = 0; row >= 0 && joint < N_JOINTS; joint++) {
      point.fromArray(one.joints, 3 * (row * N_JOINTS + joint))
      offer(index, null)
    }
  })
  motion.cameras.forEach(({ position }, index) => {
    if (!position || !hasCameras) return
    point.fromArray(position)
    offer(null, index)
  })
  return { person, camera }
}
