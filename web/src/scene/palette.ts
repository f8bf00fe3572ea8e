// Colours of people, errors and the scene.

import { Color } from 'three'

/** Distinguishable on dark and on light backgrounds, in this order. */
const PEOPLE = ['#5aa9f5', '#f2a541', '#62c27b', '#ec77a4', '#a98cf5', '#3fbfb2', '#d9c03f', '#f27961']

export function personColor(index: number) {
  return PEOPLE[index % PEOPLE.length]
}

/** Errors at or above this have the last colour of the ramp, px. */
export const WORST_PX = 16

const RAMP = ['#3fbf7f', '#d9c03f', '#f2913d', '#e5484d'].map((hex) => new Color(hex))

/** Colour of an error: green (0) over yellow to red (`WORST_PX` and above). */
export function errorColor(distance: number) {
  const at = Math.min(Math.max(distance / WORST_PX, 0), 1) * (RAMP.length - 1)
  const low = Math.min(Math.floor(at), RAMP.length - 2)
  return `#${new Color().copy(RAMP[low]).lerp(RAMP[low + 1], at - low).getHexString()}`
}

export interface SceneColors {
  background: string
  grid: string
  gridStrong: string
  line: string
  accent: string
  unobserved: string
}

/** Scene colours of the current theme, from the variables of the style sheet. */
export function sceneColors(): SceneColors {
  const style = getComputedStyle(document.documentElement)
  const read = (name: string) => style.getPropertyValue(name).trim()
  return {
    background: read('--stage'),
    grid: read('--grid'),
    gridStrong: read('--grid-strong'),
    line: read('--stage-line'),
    accent: read('--accent'),
    unobserved: read('--unobserved'),
  }
}
