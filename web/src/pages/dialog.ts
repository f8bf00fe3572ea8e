// A modal dialogue of the browser's own; gone from the page once it is closed.

import { button, type Child, el } from '../dom'

export function openDialog(title: string, ...children: Child[]): HTMLDialogElement {
  const heading = el('h2', { id: `dialog-${crypto.randomUUID()}` }, title)
  const dialog = el('dialog', { 'aria-labelledby': heading.id }, heading, ...children)
  dialog.addEventListener('close', () => dialog.remove())
  document.body.append(dialog)
  dialog.showModal()
  return dialog
}

/** Asks before something is lost. */
export function confirmLoss(question: string, act: string): Promise<boolean> {
  return new Promise((resolve) => {
    let answer = false
    const dialog = openDialog(
      question,
      el('div', { class: 'actions' },
        button('Keep it', () => dialog.close()),
        button(act, () => ((answer = true), dialog.close()), { class: 'danger' })),
    )
    dialog.addEventListener('close', () => resolve(answer))
  })
}
