// A dropped file or folder on its way to the service.

import { zipSync } from 'fflate'
import { authorization, problemFrom, unreachable } from './client'
import type { Session } from './types'

/** Something to upload: one file, or the files of a folder under their paths. */
export interface Take {
  name: string
  files: { path: string; file: File }[]
}

/** What was dropped: the only file, or everything below the only folder. */
export async function takeFromDrop(transfer: DataTransfer): Promise<Take | null> {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter((entry) => entry != null)
  if (entries.length === 0) return takeFromFiles([...transfer.files])
  const files = (await Promise.all(entries.map((entry) => filesBelow(entry, '')))).flat()
  return files.length ? { name: entries[0].name, files } : null
}

/** What was chosen in a file dialogue. */
export function takeFromFiles(files: File[]): Take | null {
  if (files.length === 0) return null
  const listed = files.map((file) => ({ path: file.webkitRelativePath || file.name, file }))
  return { name: listed[0].path.split('/')[0], files: listed }
}

async function filesBelow(entry: FileSystemEntry, folder: string): Promise<Take['files']> {
  const path = folder + entry.name
  if (entry.isFile) {
    const file = await new Promise<File>((resolve, reject) => (entry as FileSystemFileEntry).file(resolve, reject))
    return [{ path, file }]
  }
  const reader = (entry as FileSystemDirectoryEntry).createReader()
  const children: FileSystemEntry[] = []
  for (;;) {
    // A folder is told in portions, the last one empty.
    const some = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject))
    if (some.length === 0) break
    children.push(...some)
  }
  return (await Promise.all(children.map((child) => filesBelow(child, `${path}/`)))).flat()
}

/** Sends a take; `onProgress` hears the share that has left. */
export async function upload(take: Take, onProgress: (share: number) => void): Promise<Session> {
  const only = take.files.length === 1 ? take.files[0].file : null
  const type = only && mediaType(only.name)
  if (only && type) return send(only, type, onProgress)
  return send(new Blob([await zipped(take)]), 'application/zip', onProgress)
}

function mediaType(name: string) {
  if (/\.zip$/i.test(name)) return 'application/zip'
  if (/\.json$/i.test(name)) return 'application/json'
  if (/\.(ndjson|jsonl)$/i.test(name)) return 'application/x-ndjson'
  return null
}

async function zipped(take: Take): Promise<Uint8Array<ArrayBuffer>> {
  // Truth and images are no part of an upload.
  const isWanted = (path: string) => !/(^|\/)gt\//.test(path) && !/\.(jpe?g|png|mp4|mov)$/i.test(path)
  const members: Record<string, Uint8Array> = {}
  for (const { path, file } of take.files.filter(({ path }) => isWanted(path))) {
    members[path] = new Uint8Array(await file.arrayBuffer())
  }
  // `zip` deflates in workers made from blobs, which the page's policy forbids.
  return zipSync(members, { level: 1 }) as Uint8Array<ArrayBuffer>
}

/** XMLHttpRequest, since `fetch` does not tell how much of a body has left. */
function send(body: Blob, type: string, onProgress: (share: number) => void): Promise<Session> {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest()
    request.open('POST', '/v1/sessions')
    request.setRequestHeader('Content-Type', type)
    for (const [name, value] of Object.entries(authorization())) request.setRequestHeader(name, value)
    request.upload.onprogress = (event) => onProgress(event.total ? event.loaded / event.total : 0)
    request.onerror = () => reject(unreachable())
    request.onload = () => {
      if (request.status >= 200 && request.status < 300) resolve(JSON.parse(request.responseText))
      else reject(problemFrom(request.status, request.responseText))
    }
    request.send(body)
  })
}
