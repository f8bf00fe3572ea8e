// Dialogue for the API key.

import { hasKey, rememberKey } from '../api/client'
import { button, el } from '../dom'
import { openDialog } from './dialog'

/** Opens the dialogue unless one is open; `onkey` is called after a key was entered. */
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
      : 'This service requires an API key. The operator creates one with `wandless key create`.'),
    el('label', { for: 'key' }, 'API key'),
    input,
    el('p', { class: 'hint' }, 'The key is stored for this tab only and deleted when the tab is closed.'),
    el('div', { class: 'actions' }, button('Not now', () => dialog.close()), el('button', { class: 'primary' }, 'Use this key')),
  )
  form.addEventListener('submit', (event) => (event.preventDefault(), give()))
  const dialog = openDialog('API key required', form)
}
