// Curves of one joint over time, for all people: height above the floor and speed.

import type { Motion } from '../data/motion'
import { el, fill } from '../dom'
import { words } from '../format'
import { personColor } from '../scene/palette'
import { lineChart } from './charts'

export function jointCurves(motion: Motion): HTMLElement {
  const names = motion.joint_names
  const select = el('select', { 'aria-label': 'Joint' }, ...names.map((name, joint) => el('option', { value: String(joint) }, words(name))))
  select.value = String(Math.max(names.indexOf('left_wrist'), 0))
  const charts = el('div', { class: 'charts' })
  const draw = () => {
    const joint = Number(select.value)
    const lines = (of: (person: number, row: number) => number) => motion.people.map((person, i) => {
      const values = new Float32Array(motion.n_frames).fill(NaN)
      for (let row = 0; row < person.n_frames; row++) values[person.first + row] = of(i, row)
      return { name: `Person ${person.id}`, color: personColor(i), values }
    })
    fill(charts,
      lineChart(`Height of the ${words(names[joint])}`, 'm', motion.first_frame, lines((person, row) => height(motion, person, row, joint))),
      lineChart(`Speed of the ${words(names[joint])}`, 'm/s', motion.first_frame, lines((person, row) => speed(motion, person, row, joint))))
  }
  select.addEventListener('change', draw)
  draw()
  return el('section', { class: 'joint-curves', 'aria-label': 'Joint curves' }, el('h2', {}, 'Joint curves'), select, charts)
}

/** Offset of a joint in the array of a person's joints. */
function at(motion: Motion, row: number, joint: number) {
  return 3 * (row * motion.joint_names.length + joint)
}

function height(motion: Motion, person: number, row: number, joint: number) {
  return motion.people[person].joints[at(motion, row, joint) + (motion.up_axis === 'y' ? 1 : 2)]
}

/** Central difference; NaN at the ends. */
function speed(motion: Motion, person: number, row: number, joint: number) {
  const { joints, n_frames } = motion.people[person]
  if (row === 0 || row + 1 >= n_frames) return NaN
  const [before, after] = [row - 1, row + 1].map((r) => at(motion, r, joint))
  return (Math.hypot(...[0, 1, 2].map((c) => joints[after + c] - joints[before + c])) * motion.fps) / 2
}
