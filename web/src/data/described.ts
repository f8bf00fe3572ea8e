// Reader of the self-describing binary files of a result (`stages/*.bin`): a JSON header followed by arrays.

/** Description of an array in the header. */
export interface ArrayRef {
  type: 'f32' | 'u8' | 'i16' | 'u16' | 'u32'
  offset: number
  shape: number[]
}

const KINDS = { f32: Float32Array, u8: Uint8Array, i16: Int16Array, u16: Uint16Array, u32: Uint32Array }

/** A file; its arrays are views of the bytes of the file. */
export class Described<Header> {
  readonly header: Header
  private readonly file: ArrayBuffer
  private readonly payload: number

  constructor(file: ArrayBuffer, format: string) {
    const magic = String.fromCharCode(...new Uint8Array(file, 0, Math.min(8, file.byteLength)))
    if (magic !== 'WANDLESS') throw new Error('the file is not a binary file of wandless')
    this.payload = 12 + new DataView(file).getUint32(8, true)
    const header = JSON.parse(new TextDecoder().decode(new Uint8Array(file, 12, this.payload - 12)))
    if (header.format !== format || header.version !== 1) throw new Error(`the file is not a ${format} file of version 1`)
    this.header = header
    this.file = file
  }

  f32(ref: ArrayRef) {
    return this.array(ref) as Float32Array
  }

  u8(ref: ArrayRef) {
    return this.array(ref) as Uint8Array
  }

  i16(ref: ArrayRef) {
    return this.array(ref) as Int16Array
  }

  u16(ref: ArrayRef) {
    return this.array(ref) as Uint16Array
  }

  u32(ref: ArrayRef) {
    return this.array(ref) as Uint32Array
  }

  private array(ref: ArrayRef) {
    const length = ref.shape.reduce((product, n) => product * n, 1)
    return new KINDS[ref.type](this.file, this.payload + ref.offset, length)
  }
}
