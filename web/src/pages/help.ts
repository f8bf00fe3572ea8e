// Dialogue with the keyboard shortcuts.

import { button, el } from '../dom'
import { KEY_HELP } from '../scene/keys'
import { openDialog } from './dialog'

export function showHelp() {
  const rows = KEY_HELP.flatMap(([key, meaning]) => [el('dt', {}, el('kbd', {}, key)), el('dd', {}, meaning)])
  const dialog = openDialog(
    'Keyboard shortcuts',
    el('dl', { class: 'keys' }, ...rows),
    el('div', { class: 'actions' }, button('Close', () => dialog.close())),
  )
}
