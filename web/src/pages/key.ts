// Asks for the service's key where it wants one.

import { hasKey, rememberKey } from '../api/client'
import { button, el } from '../dom'
import { openDialog } from './dialog'

/** Shows the question once; `onkey` follows a given key. */
export function askForKey(onkey: () => void) {
  if (document.querySelector('dialog[open]')) return
  const input = el('input', { type: 'password', id: 'key', autocomplete: 'off', required: true })
  const give = () => {
    rememberKey(input.value.trim())
    dialog.close()
    onkey()
  }
  const form = el('form', { method: 'dialog' },
    el('p', {}, hasKey()
      ? 'The service does not accept this key. It may have been revoked or mistyped.'
      : 'This service asks for a key. The operator makes one with `wandless key create`.'),
    el('label', { for: 'key' }, 'API key'),
    input,
    el('p', { class: 'hint' }, 'It is kept for this tab only, and forgotten when the tab is closed.'),
    el('div', { class: 'actions' }, button('Not now', () => dialog.close()), el('button', { class: 'primary' }, 'Use this key')),
  )
  form.addEventListener('submit', (event) => (event.preventDefault(), give()))
  const dialog = openDialog('A key is needed', form)
}
