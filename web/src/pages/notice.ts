// Cards that explain a problem and its remedy.

import { Problem } from '../api/client'
import type { Cause } from '../api/types'
import { el } from '../dom'

/** Card of a problem of the service or of an error of the viewer. */
export function problemCard(title: string, error: unknown) {
  if (error instanceof Problem) return causeCard(title, error.cause)
  return causeCard(title, { code: 'viewer', detail: error instanceof Error ? error.message : String(error) })
}

export function causeCard(title: string, cause: Cause) {
  const locations: [string, unknown][] = [
    ['File', cause.file],
    ['Camera', cause.camera],
    ['Frame', cause.frame],
    ['Person', cause.person],
    ['Where', cause.pointer],
  ]
  const rows = locations.filter(([, value]) => value !== null && value !== undefined && value !== '')
  return el(
    'section',
    { class: 'notice bad', role: 'alert' },
    el('h3', {}, title),
    el('p', {}, sentence(cause.detail)),
    rows.length > 0 && el('dl', {}, ...rows.flatMap(([name, value]) => [el('dt', {}, name), el('dd', {}, String(value))])),
    cause.remedy ? el('p', { class: 'remedy' }, el('strong', {}, 'What to do: '), sentence(cause.remedy)) : null,
  )
}

/** Turns a clause of the service into a sentence. */
function sentence(text: string) {
  const [first = '', ...rest] = text
  return first.toUpperCase() + rest.join('') + (/[.!?:)\]}>]$/.test(text) ? '' : '.')
}
