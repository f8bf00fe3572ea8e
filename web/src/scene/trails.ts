// Paths of people on the floor; the last two seconds are highlighted.

import { BufferGeometry, Float32BufferAttribute, Line, LineBasicMaterial, type Object3D } from 'three'
import { type Motion, N_JOINTS } from '../data/motion'
import { personColor } from './palette'

const RECENT_SECS = 2

/** Height above the floor, m; prevents flickering with the grid. */
const HEIGHT = 0.006

export class Trails {
  private readonly lines: { whole: Line; recent: Line; first: number; n: number }[]

  constructor(private readonly motion: Motion, parent: Object3D) {
    const up = motion.up_axis === 'y' ? 1 : 2
    this.lines = motion.people.map((person, index) => {
      const path = new Float32Array(3 * person.n_frames)
      for (let row = 0; row < person.n_frames; row++) {
        for (let c = 0; c < 3; c++) path[3 * row + c] = c === up ? HEIGHT : person.joints[3 * N_JOINTS * row + c]
      }
      const line = (opacity: number) => {
        const geometry = new BufferGeometry().setAttribute('position', new Float32BufferAttribute(path, 3))
        const material = new LineBasicMaterial({ color: personColor(index), transparent: true, opacity })
        return new Line(geometry, material)
      }
      const [whole, recent] = [line(0.22), line(0.95)]
      parent.add(whole, recent)
      return { whole, recent, first: person.first, n: person.n_frames }
    })
  }

  show(frame: number, isShown: boolean) {
    const length = Math.round(RECENT_SECS * this.motion.fps)
    for (const { whole, recent, first, n } of this.lines) {
      whole.visible = recent.visible = isShown
      const end = Math.min(Math.max(frame - first + 1, 0), n)
      const start = Math.max(end - length, 0)
      recent.geometry.setDrawRange(start, end - start)
    }
  }

  dispose() {
    for (const line of this.lines.flatMap(({ whole, recent }) => [whole, recent])) {
      line.geometry.dispose()
      ;(line.material as LineBasicMaterial).dispose()
    }
  }
}
