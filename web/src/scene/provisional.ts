// Picture of a running job: the cameras and points that are known so far, played in a loop.

import { type ProvisionalScene, motionOf } from '../data/provisional'
import type { Motion } from '../data/motion'
import { button, el } from '../dom'
import { words } from '../format'
import { onThemeChange } from '../theme'
import { LAYERS, People } from './people'
import { Rig } from './rig'
import { Stage } from './stage'
import { openSurface } from './surface'

/** Slowest playback, shown frames per second; long takes show few of their frames. */
const MIN_FPS = 8

/** Most pictures per second, and with software rendering: the machine that draws may be the one that solves. */
const [MAX_FPS, MAX_SLOW_FPS] = [12, 4]

const LOOK = { body: false, skeleton: false, points: true, selected: null, isMuted: false }

export class ProvisionalView {
  private readonly box = el('div', { class: 'stage' })
  private readonly caption = el('p', { class: 'hint', 'aria-live': 'polite' })
  private readonly toggle = button('Pause', () => this.play(!this.isPlaying), { class: 'quiet' })
  readonly element = el('figure', { class: 'provisional', hidden: true, 'aria-label': 'Provisional scene' }, this.box,
    el('figcaption', {}, this.caption, this.toggle))
  private readonly observer = new ResizeObserver(() => this.resize())
  private readonly unsubscribe = onThemeChange(() => (this.stage?.repaint(), this.draw()))
  private motion: Motion | null = null
  private stage: Stage | null = null
  private people: People | null = null
  private rig: Rig | null = null
  private isPlaying = !matchMedia('(prefers-reduced-motion: reduce)').matches
  private maxFps = MAX_FPS
  private timer = 0
  private at = 0

  /** Shows a newer scene; the view that the user has chosen stays. Browsers without WebGL 2 show none. */
  show(scene: ProvisionalScene) {
    const motion = motionOf(scene)
    try {
      this.stage ??= this.opened(motion)
    } catch {
      return
    }
    this.clear()
    this.motion = motion
    this.people = new People(motion, this.stage.world, this.stage.lens)
    this.rig = new Rig(motion.cameras, this.stage.world, this.stage.lens)
    const placed = motion.cameras.filter(({ R }) => R !== null).length
    this.caption.textContent = `Provisional, after “${words(scene.stage)}”: ${placed} of ${motion.cameras.length} cameras, `
      + `${motion.people.length} ${motion.people.length === 1 ? 'person' : 'people'}. Bodies, scale and the last adjustment follow.`
    Object.assign(this.element.dataset, { stage: scene.stage, cameras: placed, people: motion.people.length })
    this.element.hidden = false
    this.play(this.isPlaying)
    this.resize()
  }

  private opened(motion: Motion) {
    const surface = openSurface()
    if (surface.isSlow) this.maxFps = MAX_SLOW_FPS
    const stage = new Stage(motion, surface, () => this.isPlaying || this.draw())
    this.box.append(stage.canvas)
    this.observer.observe(this.box)
    return stage
  }

  private play(isPlaying: boolean) {
    this.isPlaying = isPlaying
    this.toggle.textContent = isPlaying ? 'Pause' : 'Play'
    clearInterval(this.timer)
    const fps = Math.max(this.motion?.fps ?? 0, MIN_FPS)
    const step = Math.max(1, fps / this.maxFps)
    if (isPlaying) this.timer = window.setInterval(() => this.advance(step), (1000 * step) / fps)
  }

  private advance(frames: number) {
    this.at = (this.at + frames) % Math.max(this.motion?.n_frames ?? 0, 1)
    this.draw()
  }

  private draw() {
    const { clientWidth: width, clientHeight: height } = this.box
    if (!this.stage || width === 0 || height === 0) return
    this.people?.show(Math.floor(this.at), LOOK, null, this.stage.colors)
    this.rig?.show(true, null, null, this.stage.colors)
    this.stage.clear()
    this.stage.drawFree({ left: 0, top: 0, width, height }, [LAYERS.shared, LAYERS.points])
  }

  private resize() {
    const { clientWidth: width, clientHeight: height } = this.box
    if (width > 0 && height > 0) this.stage?.resize(width, height)
    this.draw()
  }

  private clear() {
    for (const part of [this.people, this.rig]) part?.dispose()
    this.stage?.world.clear()
  }

  close() {
    clearInterval(this.timer)
    this.observer.disconnect()
    this.unsubscribe()
    this.clear()
    this.stage?.dispose()
    this.stage = null
    this.element.hidden = true
  }
}
