// Links to a moment of a result: frame number, camera and person in the address.

import type { SceneState } from './state'
import type { SceneView } from './view'

/** The address of the scene as it is shown now. */
export function linkTo(view: SceneView): string {
  const { motion, state } = view
  const asked = new URLSearchParams({ frame: String(motion.first_frame + view.frame) })
  if (state.through !== null) asked.set('camera', motion.cameras[state.through].id)
  if (state.person !== null) asked.set('person', String(motion.people[state.person].id))
  const [, kind, job] = location.hash.split('?')[0].split('/')
  return `${location.origin}${location.pathname}#/${kind}/${job}/scene?${asked}`
}

/** Shows what the address asks for; frames, cameras and people that the result lacks are ignored. */
export function followLink(view: SceneView) {
  const asked = new URLSearchParams(location.hash.split('?')[1] ?? '')
  const { motion } = view
  const change: Partial<SceneState> = {}
  const frame = Number(asked.get('frame') ?? NaN)
  if (Number.isInteger(frame)) Object.assign(change, { at: frame - motion.first_frame, isPlaying: false })
  const camera = motion.cameras.findIndex(({ id, R }) => id === asked.get('camera') && R)
  if (camera >= 0) Object.assign(change, { through: camera, camera })
  const person = motion.people.findIndex(({ id }) => String(id) === asked.get('person'))
  if (person >= 0) change.person = person
  if (Object.keys(change).length) view.set(change)
}
