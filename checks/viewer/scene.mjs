// The scene of a job: loading time, memory, and correctness of its projections.

import { readFileSync, readdirSync } from 'node:fs'
import { check } from './browser.mjs'
import { projected } from './lenses.mjs'

/** Waits until the scene with its bodies is loaded. */
export const sceneReady = (page) => page.waitForFunction(() => window.wandless, null, { timeout: 120_000 })

/** Waits for the next picture. */
export const drawn = (page) => page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))))

/** Number of measurements of the first view. The fastest one counts, because other load only adds time. */
const VIEWS = 3

/** Time and bytes of the first view of a finished job, each in a new browser context. */
export async function checkFirstView(open, base, job, what) {
  const views = []
  for (let i = 0; i < VIEWS; i++) views.push(await firstView(await open(), base, job))
  const times = views.map(({ secs }) => secs.toFixed(2)).join(', ')
  const [secs, bytes] = [Math.min(...views.map(({ secs }) => secs)), Math.max(...views.map(({ bytes }) => bytes))]
  check(`${what}: first view within 1.5 s`, secs <= 1.5, `${times} s`)
  check(`${what}: at most 15 MB`, bytes <= 15e6, `${(bytes / 1e6).toFixed(2)} MB`)
}

async function firstView(page, base, job) {
  let bytes = 0
  const session = await page.context().newCDPSession(page)
  await session.send('Network.enable')
  session.on('Network.loadingFinished', ({ encodedDataLength }) => (bytes += encodedDataLength))
  const start = Date.now()
  await page.goto(`${base}/#/jobs/${job.id}`)
  await sceneReady(page)
  await drawn(page)
  const secs = (Date.now() - start) / 1000
  await page.context().close()
  return { secs, bytes }
}

/** Compares the joints of the overlay and the 3D picture with an independent projection of the result files. */
export async function checkProjection(page, base, job, what) {
  const file = async (name) => (await fetch(`${base}/v1/jobs/${job.id}/artifacts/${name}`)).json()
  const [{ cameras }, { frames }] = await Promise.all([file('cameras.json'), file('poses3d.json')])
  const numbers = Object.keys(frames).map(Number)
  let [worstOverlay, worstPicture, n] = [0, 0, 0]
  for (const number of numbers.filter((_, i) => i % 37 === 0)) {
    for (const [c, camera] of cameras.entries()) {
      for (const [person, joints] of Object.values(frames[number]).entries()) {
        const drawn = await page.evaluate(([...key]) => window.wandless.projectedJoints(...key), [c, number - numbers[0], person])
        for (const [j, joint] of joints.entries()) {
          const expected = camera.R && projected(camera, joint)
          if (!expected) continue
          n++
          worstOverlay = Math.max(worstOverlay, distance(expected.distorted, [drawn[2 * j], drawn[2 * j + 1]]))
        }
        const expected = camera.R && projected(camera, joints[0])
        if (!expected) continue
        const shown = await page.evaluate(([...key]) => window.wandless.pixelThrough(...key), [c, joints[0]])
        worstPicture = Math.max(worstPicture, distance(expected.pinhole, shown))
      }
    }
  }
  check(`${what}: overlay against cameras.json x poses3d.json within 0.5 px`, n > 0 && worstOverlay <= 0.5, `${worstOverlay.toFixed(4)} px over ${n} joints`)
  check(`${what}: picture through the camera, without distortion, within 0.5 px`, n > 0 && worstPicture <= 0.5, `${worstPicture.toFixed(4)} px`)
}

const distance = ([a, b], [c, d]) => Math.hypot(a - c, b - d)

/** Plays for some time; measures frame times and the memory of scripts, GPU and browser. */
export async function checkPlay(page, minutes, what) {
  const heap = async () => {
    const session = await page.context().newCDPSession(page)
    await session.send('HeapProfiler.collectGarbage')
    const { usedSize, backingStorageSize = 0 } = await session.send('Runtime.getHeapUsage')
    await session.detach()
    return usedSize + backingStorageSize
  }
  await page.locator('.stage canvas').first().focus()
  await page.keyboard.press('Space')
  await page.waitForTimeout(3000)
  const [before, held, resident] = [await heap(), await page.evaluate(() => window.wandless.memory()), residentOfBrowser()]
  await page.waitForTimeout(minutes * 60_000)
  const [after, holds, resides] = [await heap(), await page.evaluate(() => window.wandless.memory()), residentOfBrowser()]
  const times = (await page.evaluate(() => window.wandless.frameTimes())).sort((a, b) => a - b)
  await page.keyboard.press('Space')
  const at = (share) => times[Math.floor(share * (times.length - 1))]?.toFixed(1)
  check(`${what}: frame time`, times.length > 0, `median ${at(0.5)} ms, 95 % ${at(0.95)} ms`)
  const grown = `${(before / 1e6).toFixed(1)} to ${(after / 1e6).toFixed(1)} MB in ${minutes} min, geometries ${held.geometries} to ${holds.geometries}`
  check(`${what}: memory does not grow`, after < Math.max(1.1 * before, before + 8e6) && holds.geometries === held.geometries, grown)
  check(`${what}: memory of the browser does not grow`, resides < 1.15 * resident + 40e6, `${(resident / 1e6).toFixed(0)} to ${(resides / 1e6).toFixed(0)} MB resident`)
}

/** Resident memory of all browser processes of this check. */
function residentOfBrowser() {
  const parents = new Map()
  const sizes = new Map()
  for (const id of readdirSync('/proc').filter((name) => /^\d+$/.test(name))) {
    try {
      const status = readFileSync(`/proc/${id}/status`, 'utf8')
      parents.set(id, /^PPid:\s*(\d+)/m.exec(status)?.[1])
      if (/^Name:\s*chrom/m.test(status)) sizes.set(id, 1024 * Number(/^VmRSS:\s*(\d+)/m.exec(status)?.[1] ?? 0))
    } catch {
      // The process has ended.
    }
  }
  const isOurs = (id) => id === String(process.pid) || (parents.has(id) && isOurs(parents.get(id)))
  return [...sizes].filter(([id]) => isOurs(id)).reduce((sum, [, size]) => sum + size, 0)
}

/** Every finger joint of a person at a frame is the end of a drawn bone, where the skeleton is shown. */
export async function checkFingers(page, base, job) {
  const { people } = await (await fetch(`${base}/v1/jobs/${job.id}/artifacts/people.json`)).json()
  const first = people.map(({ frames }) => frames[0]).reduce((a, b) => Math.min(a, b))
  await page.keyboard.press('s')
  let [worst, n] = [0, 0]
  for (const person of people.filter(({ hands }) => hands)) {
    for (const row of [0, person.frames.length - 1]) {
      await page.evaluate((frame) => window.wandless.seek(frame), person.frames[row] - first)
      await drawn(page)
      const ends = await page.evaluate(() => window.wandless.skeletonEnds())
      for (const joint of [person.hands.left, person.hands.right].flatMap(({ joints }) => joints[row])) {
        const apart = ends.map((end) => Math.hypot(...end.map((c, i) => c - joint[i])))
        worst = Math.max(worst, Math.min(Infinity, ...apart))
        n++
      }
    }
  }
  check('fingers are drawn with the skeleton, within 0.1 mm of people.json', n > 0 && worst <= 1e-4, `${(1000 * worst).toFixed(4)} mm over ${n} joints`)
}

/** Joints that are rarely occluded: wrists and ankles. */
const ENDS = [20, 21, 7, 8]

/** Checks that skeletons are drawn at their distorted positions, and not at those of a pinhole camera. */
export async function checkLens(page, base, job, camera, what) {
  const file = async (name) => (await fetch(`${base}/v1/jobs/${job.id}/artifacts/${name}`)).json()
  const [{ cameras }, { frames }] = await Promise.all([file('cameras.json'), file('poses3d.json')])
  const numbers = Object.keys(frames).map(Number)
  const points = { distorted: [], pinhole: [] }
  for (const number of numbers.filter((_, i) => i % 5 === 0)) {
    const seen = Object.values(frames[number]).flatMap((joints) => ENDS.map((j) => projected(cameras[camera], joints[j])))
    const isInside = ([x, y]) => x > 8 && y > 8 && x < cameras[camera].width - 8 && y < cameras[camera].height - 8
    // Only joints that the distortion moves by more than the size of their marker are informative.
    const informative = seen.filter((one) => one && isInside(one.distorted) && isInside(one.pinhole) && distance(one.distorted, one.pinhole) > 16)
    for (const kind of ['distorted', 'pinhole']) points[kind].push({ frame: number - numbers[0], pixels: informative.map((one) => one[kind]) })
  }
  const [bent, straight] = [await inked(page, camera, cameras[camera], points.distorted), await inked(page, camera, cameras[camera], points.pinhole)]
  check(`${what}: the picture is distorted as by the lens`, bent.n > 10 && bent.share > 0.97 && straight.share < 0.8,
    `${bent.n} joints, ${(100 * bent.share).toFixed(0)} % at the distorted position, ${(100 * straight.share).toFixed(0)} % at the pinhole position`)
}

/** Share of the given image pixels at which something is drawn. */
async function inked(page, index, { width }, frames) {
  const hits = []
  for (const { frame, pixels } of frames.filter(({ pixels }) => pixels.length)) {
    hits.push(...await page.evaluate(([index, width, frame, pixels]) => new Promise((resolve) => {
      window.wandless.seek(frame)
      requestAnimationFrame(() => {
        const stage = document.querySelector('.stage canvas')
        const copy = document.createElement('canvas')
        Object.assign(copy, { width: stage.width, height: stage.height })
        const context = copy.getContext('2d', { willReadFrequently: true })
        context.drawImage(stage, 0, 0)
        const part = window.wandless.pictureOf(index)
        const zoom = (part.width / width) * (stage.width / stage.clientWidth)
        const ratio = stage.width / stage.clientWidth
        const color = (x, y) => context.getImageData(Math.round(x), Math.round(y), 1, 1).data.slice(0, 3)
        const empty = color(4, 4)
        resolve(pixels.map(([u, v]) => {
          const found = color(part.left * ratio + (u + 0.5) * zoom, part.top * ratio + (v + 0.5) * zoom)
          return found.some((c, i) => Math.abs(c - empty[i]) > 14)
        }))
      })
    }), [index, width, frame, pixels]))
  }
  return { n: hits.length, share: hits.filter(Boolean).length / Math.max(hits.length, 1) }
}
