// Controls of the scene page: transport below the picture, display switches above it.

import { button, el, fill } from '../dom'
import { showHelp } from '../pages/help'
import { type Comparison, SPEEDS, SWITCHES, comparisonsOf } from './state'
import { linkTo } from './link'
import type { SceneView } from './view'

/** Play, step, speed, marks and clock. */
export class Transport {
  readonly element: HTMLElement
  private readonly play: HTMLButtonElement
  private readonly speed: HTMLSelectElement
  private readonly clock = el('span', { class: 'clock' })
  private readonly notice = el('span', { class: 'hint', role: 'status' })

  constructor(private readonly view: SceneView) {
    const step = (by: number) => view.set({ at: view.frame + by, isPlaying: false })
    this.play = button('Play', () => view.set({ isPlaying: !view.state.isPlaying }), { class: 'play' })
    const options = SPEEDS.map((speed) => el('option', { value: String(speed) }, `${speed} ×`))
    this.speed = el('select', { 'aria-label': 'Speed' }, ...options)
    this.speed.addEventListener('change', () => view.set({ speed: Number(this.speed.value) }))
    this.element = el(
      'div',
      { class: 'transport' },
      button('One frame back', () => step(-1), { class: 'icon', 'aria-label': 'One frame back', title: '←' }, '‹'),
      this.play,
      button('One frame forward', () => step(1), { class: 'icon', 'aria-label': 'One frame forward', title: '→' }, '›'),
      this.speed,
      button('Previous mark', () => view.toMark(-1), { 'aria-label': 'Previous mark', title: 'Previous repair or rejection (,)' }, '◂ Mark'),
      button('Next mark', () => view.toMark(1), { 'aria-label': 'Next mark', title: 'Next repair or rejection (.)' }, 'Mark ▸'),
      this.clock,
      el('span', { class: 'legend marks' },
        el('span', {}, '◆ identity repaired'),
        el('span', {}, el('i', { class: 'mark repaired' }), 'detection repaired'),
        el('span', {}, el('i', { class: 'mark rejected' }), 'detection rejected')),
      button('Copy link', () => this.copy(linkTo(view)), { class: 'quiet', title: 'Link to this frame, camera and person' }),
      this.notice,
      button('Shortcuts', showHelp, { class: 'quiet', title: '?' }),
    )
  }

  /** Copies a link. Pages of plain HTTP addresses other than the loopback have no clipboard: there the link is shown. */
  private copy(link: string) {
    if (navigator.clipboard) void navigator.clipboard.writeText(link).then(() => this.note('link copied'))
    else prompt('Link to this frame, camera and person', link)
  }

  /** Shows a short notice for a moment. */
  private note(text: string) {
    this.notice.textContent = text
    setTimeout(() => (this.notice.textContent = ''), 2000)
  }

  /** Updates the clock and returns its text. */
  show() {
    const { view } = this
    const { fps, first_frame, n_frames } = view.motion
    this.play.textContent = view.state.isPlaying ? 'Pause' : 'Play'
    this.speed.value = String(view.state.speed)
    const seconds = (view.frame / fps).toFixed(2)
    const text = `frame ${first_frame + view.frame} · ${seconds} s of ${((n_frames - 1) / fps).toFixed(2)} s`
    if (this.clock.textContent !== text) this.clock.textContent = text
    return text
  }
}

/** Display switches and the choice of the comparison. */
export class Switches {
  readonly element = el('div', { class: 'switches', role: 'toolbar', 'aria-label': 'Display' })
  private isThrough: boolean | null = null
  private compared: HTMLSelectElement | null = null

  constructor(private readonly view: SceneView) {}

  show() {
    const isThrough = this.view.state.through !== null
    if (isThrough !== this.isThrough) this.build(isThrough)
    this.isThrough = isThrough
    if (this.compared) this.compared.value = this.view.state.compared
    for (const child of this.element.querySelectorAll('button')) {
      const found = SWITCHES.find(({ name }) => name === child.dataset.switch)
      if (found) child.setAttribute('aria-pressed', String(this.view.state[found.name]))
    }
  }

  private build(isThrough: boolean) {
    const shown = SWITCHES.filter(({ inCamera, name }) => inCamera === isThrough || (isThrough && ['body', 'skeleton'].includes(name)))
    const buttons = shown.map(({ name, label, key, title }) =>
      button(label, () => this.view.set({ [name]: !this.view.state[name] }), {
        'data-switch': name,
        'aria-pressed': 'false',
        title: `${title} (${key.toUpperCase()})`,
      }),
    )
    const pairs = comparisonsOf(this.view.motion, isThrough).map(({ name, label }) => el('option', { value: name }, label))
    this.compared = el('select', { 'aria-label': 'Side by side', title: 'Two pictures side by side (V)' }, ...pairs)
    this.compared.addEventListener('change', () => this.view.set({ compared: this.compared!.value as Comparison }))
    fill(this.element, ...buttons, pairs.length > 1 && this.compared)
  }
}
