// Modal dialogues; removed from the page when they are closed.

import { button, type Child, el } from '../dom'

let opened = 0

export function openDialog(title: string, ...children: Child[]): HTMLDialogElement {
  const heading = el('h2', { id: `dialog-${++opened}` }, title)
  const dialog = el('dialog', { 'aria-labelledby': heading.id }, heading, ...children)
  dialog.addEventListener('close', () => dialog.remove())
  document.body.append(dialog)
  dialog.showModal()
  return dialog
}

/** Asks for confirmation of a deletion; `action` labels the confirming button. */
export function confirmDeletion(question: string, action: string): Promise<boolean> {
  return new Promise((resolve) => {
    let isConfirmed = false
    const dialog = openDialog(
      question,
      el('div', { class: 'actions' },
        button('Keep it', () => dialog.close()),
        button(action, () => ((isConfirmed = true), dialog.close()), { class: 'danger' })),
    )
    dialog.addEventListener('close', () => resolve(isConfirmed))
  })
}
