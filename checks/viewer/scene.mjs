// The scene of a job: what it costs to show it, and whether it shows what the result says.

import { check } from './browser.mjs'

/** Waits until the scene can be asked. */
export const sceneReady = (page) => page.waitForFunction(() => window.wandless, null, { timeout: 60_000 })

/** Time and bytes of the first view of a finished job. */
export async function checkFirstView(page, base, job, what) {
  let bytes = 0
  const session = await page.context().newCDPSession(page)
  await session.send('Network.enable')
  session.on('Network.loadingFinished', ({ encodedDataLength }) => (bytes += encodedDataLength))
  const start = Date.now()
  await page.goto(`${base}/#/jobs/${job.id}`)
  await sceneReady(page)
  await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))))
  const secs = (Date.now() - start) / 1000
  check(`${what}: first view within 2 s`, secs <= 2, `${secs.toFixed(2)} s`)
  check(`${what}: at most 15 MB`, bytes <= 15e6, `${(bytes / 1e6).toFixed(2)} MB`)
  await session.detach()
}

/** The overlay's joints, and the picture's own camera, against an independent projection of the result's files. */
export async function checkProjection(page, base, job) {
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
        const shown = await page.evaluate(([...key]) => window.wandless.pixelThrough(...key), [c, joints[0]])
        const expected = projected(camera, joints[0])
        if (expected) worstPicture = Math.max(worstPicture, distance(expected.pinhole, shown))
      }
    }
  }
  check('overlay against cameras.json x poses3d.json within 0.5 px', n > 0 && worstOverlay <= 0.5, `${worstOverlay.toFixed(4)} px over ${n} joints`)
  check('picture through the camera within 0.5 px', n > 0 && worstPicture <= 0.5, `${worstPicture.toFixed(4)} px`)
}

/** OpenCV's models, written out once more so that the viewer is not judged by itself. */
function projected({ K, R, t, dist, distortion_model }, point) {
  const [x, y, z] = R.map((row, i) => row[0] * point[0] + row[1] * point[1] + row[2] * point[2] + t[i])
  if (z < 1e-3) return null
  const [a, b] = [x / z, y / z]
  const s = a * a + b * b
  const bent = distortion_model === 'fisheye' ? fisheye(a, b, dist) : polynomial(a, b, s, dist)
  const pixel = ([u, v]) => [K[0][0] * u + K[0][1] * v + K[0][2], K[1][1] * v + K[1][2]]
  return { distorted: pixel(bent), pinhole: pixel([a, b]) }
}

function polynomial(a, b, s, [k1, k2, p1, p2, k3, k4 = 0, k5 = 0, k6 = 0]) {
  const scale = (1 + k1 * s + k2 * s ** 2 + k3 * s ** 3) / (1 + k4 * s + k5 * s ** 2 + k6 * s ** 3)
  return [a * scale + 2 * p1 * a * b + p2 * (s + 2 * a * a), b * scale + p1 * (s + 2 * b * b) + 2 * p2 * a * b]
}

function fisheye(a, b, k) {
  const r = Math.hypot(a, b)
  const angle = Math.atan(r)
  const scale = r > 0 ? k.reduce((sum, k, i) => sum + k * angle ** (2 * i + 3), angle) / r : 1
  return [a * scale, b * scale]
}

const distance = ([a, b], [c, d]) => Math.hypot(a - c, b - d)

/** Plays for a while: the time between pictures, and whether memory grows. */
export async function checkPlay(page, minutes, what) {
  const heap = async () => {
    const session = await page.context().newCDPSession(page)
    await session.send('HeapProfiler.collectGarbage')
    const { usedSize } = await session.send('Runtime.getHeapUsage')
    await session.detach()
    return usedSize
  }
  await page.locator('.stage canvas').first().focus()
  await page.keyboard.press('Space')
  await page.waitForTimeout(3000)
  const [before, held] = [await heap(), await page.evaluate(() => window.wandless.memory())]
  await page.waitForTimeout(minutes * 60_000)
  const [after, holds] = [await heap(), await page.evaluate(() => window.wandless.memory())]
  const times = (await page.evaluate(() => window.wandless.frameTimes())).sort((a, b) => a - b)
  await page.keyboard.press('Space')
  const at = (share) => times[Math.floor(share * (times.length - 1))]?.toFixed(1)
  check(`${what}: frame time stated`, times.length > 0, `median ${at(0.5)} ms, 95 % ${at(0.95)} ms`)
  const grown = `${(before / 1e6).toFixed(1)} to ${(after / 1e6).toFixed(1)} MB in ${minutes} min, geometries ${held.geometries} to ${holds.geometries}`
  check(`${what}: memory does not grow`, after < Math.max(1.1 * before, before + 8e6) && holds.geometries === held.geometries, grown)
}
