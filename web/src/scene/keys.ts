// Keyboard shortcuts of the scene page.

import { SPEEDS, SWITCHES, comparisonsOf } from './state'
import type { SceneView } from './view'

/** Keys and their actions, for the help dialogue. */
export const KEY_HELP: [string, string][] = [
  ['Space', 'play or pause'],
  ['← →', 'one frame back or forward; ten with Shift'],
  ['Home End', 'first and last frame'],
  [', .', 'previous or next mark (repair or rejection)'],
  ['[ ]', 'slower, faster'],
  ['1 – 9', 'look through a camera; the same key or Esc returns'],
  ['Tab', 'next control; Enter activates it'],
  ...SWITCHES.map(({ key, title }): [string, string] => [key.toUpperCase(), title.charAt(0).toLowerCase() + title.slice(1)]),
  ['V', 'compare side by side: raw and denoised, points and body'],
  ['F', 'centre the selection, or reset the view'],
  ['Alt ← → ↑ ↓', 'rotate the view'],
  ['+ −', 'zoom in, zoom out'],
  ['?', 'show this list'],
]

/** Handles a key; false if the key has no action. */
export function press(view: SceneView, event: KeyboardEvent, help: () => void): boolean {
  if (event.ctrlKey || event.metaKey || isTyping(event.target)) return false
  const { state } = view
  const step = event.shiftKey ? 10 : 1
  if (event.altKey) return rotate(view, event.key)
  switch (event.key) {
    case ' ':
      if (event.target instanceof HTMLButtonElement) return false
      view.set({ isPlaying: !state.isPlaying })
      return true
    case 'ArrowLeft':
      view.set({ at: view.frame - step, isPlaying: false })
      return true
    case 'ArrowRight':
      view.set({ at: view.frame + step, isPlaying: false })
      return true
    case 'Home':
      view.set({ at: 0 })
      return true
    case 'End':
      view.set({ at: view.lastFrame, isPlaying: false })
      return true
    case ',':
    case '.':
      view.toMark(event.key === '.' ? 1 : -1)
      return true
    case 'v':
    case 'V':
      view.set({ compared: otherComparison(view) })
      return true
    case '[':
    case ']':
      view.set({ speed: otherSpeed(state.speed, event.key === ']' ? 1 : -1) })
      return true
    case '+':
    case '=':
    case '-':
      view.stage.orbit(0, 0, event.key === '-' ? 1.12 : 1 / 1.12)
      return true
    case 'Escape':
      if (state.through === null) view.set({ person: null, camera: null })
      else view.set({ through: null })
      return true
    case 'f':
    case 'F':
      view.frameSelected()
      return true
    case '?':
      help()
      return true
  }
  return pressSwitch(view, event.key.toLowerCase()) || pressNumber(view, event.key)
}

function otherComparison({ motion, state }: SceneView) {
  const names = comparisonsOf(motion, state.through !== null).map(({ name }) => name)
  return names[(names.indexOf(state.compared) + 1) % names.length]
}

function pressSwitch(view: SceneView, key: string) {
  const found = SWITCHES.find((one) => one.key === key)
  if (found) view.set({ [found.name]: !view.state[found.name] })
  return found !== undefined
}

function pressNumber(view: SceneView, key: string) {
  const index = /^[1-9]$/.test(key) ? Number(key) - 1 : -1
  if (!view.motion.cameras[index]?.R) return false
  view.set(view.state.through === index ? { through: null } : { through: index, camera: index })
  return true
}

function rotate(view: SceneView, key: string) {
  const arrows: Record<string, [number, number]> = {
    ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.06], ArrowDown: [0, 0.06],
  }
  if (!arrows[key]) return false
  view.stage.orbit(...arrows[key], 1)
  return true
}

function otherSpeed(speed: number, by: number) {
  const index = SPEEDS.indexOf(speed) + by
  return SPEEDS[Math.min(Math.max(index, 0), SPEEDS.length - 1)]
}

function isTyping(target: EventTarget | null) {
  if (target instanceof HTMLInputElement) return target.type !== 'range' && target.type !== 'checkbox'
  return target instanceof HTMLTextAreaElement || target instanceof HTMLSelectElement
}
