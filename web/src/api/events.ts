// Server-sent events read with `fetch`: `EventSource` could not carry the service's key.

export interface ServerEvent {
  name: string
  data: string
  id: string | null
}

/** Nothing for so long (the service sends a comment every 10 s): the stream is dead, ms. */
const SILENCE_MS = 25_000

/** The events of an answer as they come; ends with the stream, or after `SILENCE_MS` without a byte. */
export async function* eventsOf(answer: Response): AsyncGenerator<ServerEvent> {
  const reader = answer.body?.getReader()
  if (!reader) return
  const decoder = new TextDecoder()
  let text = ''
  try {
    for (;;) {
      const portion = await within(reader.read(), SILENCE_MS)
      if (!portion || portion.done) return
      text += decoder.decode(portion.value, { stream: true }).replaceAll('\r', '')
      const blocks = text.split('\n\n')
      text = blocks.pop() ?? ''
      for (const block of blocks) {
        const event = eventOf(block)
        if (event) yield event
      }
    }
  } finally {
    reader.cancel().catch(() => {})
  }
}

/** One block of lines; nothing where it only says that the stream is alive. */
function eventOf(block: string): ServerEvent | null {
  const event: ServerEvent = { name: 'message', data: '', id: null }
  for (const line of block.split('\n')) {
    const [, field, value] = /^([a-z]+): ?(.*)$/.exec(line) ?? []
    if (field === 'event') event.name = value
    if (field === 'id') event.id = value
    if (field === 'data') event.data += (event.data && '\n') + value
  }
  return event.data ? event : null
}

/** What a promise gives, or null after `ms`. */
function within<T>(promise: Promise<T>, ms: number): Promise<T | null> {
  let timer = 0
  const late = new Promise<null>((resolve) => (timer = window.setTimeout(() => resolve(null), ms)))
  return Promise.race([promise, late]).finally(() => clearTimeout(timer))
}
