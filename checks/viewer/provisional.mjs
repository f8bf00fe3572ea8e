// The provisional scene of a running job.

import { check, checkAccess, shot } from './browser.mjs'
import { drawn } from './scene.mjs'

/** Picture of the scene; two of them are equal while it is paused. */
async function picture(page) {
  const clip = await page.locator('.provisional .stage').evaluate((stage) => {
    const { x, y, width, height } = stage.getBoundingClientRect()
    return { x, y, width, height }
  })
  return (await page.screenshot({ clip })).toString('base64')
}

/** Cameras and people are shown while the job of the page runs; the scene plays, pauses, and fits a phone. */
export async function checkProvisional(page) {
  const scene = page.locator('.provisional')
  await scene.waitFor({ timeout: 90_000 })
  const { cameras, people, stage } = await scene.evaluate(({ dataset }) => ({ ...dataset }))
  check('cameras and people are shown while the job runs', Number(cameras) >= 3 && Number(people) >= 2, `${cameras} cameras, ${people} people after ${stage}`)
  check('the provisional scene is named as such', /^Provisional/.test(await scene.locator('figcaption').innerText()))
  const first = await picture(page)
  await page.waitForTimeout(700)
  check('the provisional scene plays', (await picture(page)) !== first)
  await scene.getByRole('button', { name: 'Pause' }).click()
  await drawn(page)
  const paused = await picture(page)
  await page.waitForTimeout(400)
  const isSame = (await picture(page)) === paused || (await scene.evaluate(({ dataset }) => dataset.stage)) !== stage
  check('the provisional scene can be paused', isSame)
  await shot(page, 'provisional')
  await checkAccess(page, 'provisional scene')
  const size = page.viewportSize()
  await page.setViewportSize({ width: 390, height: 844 })
  await drawn(page)
  const overflow = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth)
  check('on a phone the provisional scene is not wider than the screen', overflow <= 0 && (await scene.isVisible()), `${overflow} px`)
  await shot(page, 'phone-provisional')
  await checkAccess(page, 'provisional scene on a phone')
  await page.setViewportSize(size)
}
