//! Numeric arrays from a pickle's tree: numpy arrays, scipy's sparse matrices, chumpy's `Ch` and `Select`.

use super::error::BodyFileError;
use super::fields::{FIELDS, Fields, MAX_ELEMENTS, max_elements};
use super::larger_models::LargerModel;
use super::pickle::{Global, Node, NodeId, Pickle, parse};
use crate::formats::npy::{Array, Header, NumberType, n_elements};
use std::borrow::Cow;
use std::cell::Cell;

/// Deepest nesting that is read: 6 in released models, unbounded in a pickle that contains itself.
const MAX_DEPTH: usize = 64;

/// Most arrays that are read of one file: ten fields of at most four. An array that others refer to is read again for each, so
/// that without a limit a chain of 20 that each refer twice to the one before takes a million reads.
const MAX_ARRAYS: usize = 256;

/// Most dimensions of an array: numpy's own limit.
const MAX_DIMENSIONS: usize = 64;

/// Reads the fields of a body model from a pickle.
pub(super) fn read_fields(bytes: &[u8]) -> Result<Fields, BodyFileError> {
    dictionary_arrays(bytes, &FIELDS, max_elements, refuse_other_models)
}

/// Rejects larger models of the family by their weights, before their larger arrays are read.
fn refuse_other_models(field: &str, array: &Array) -> Result<(), BodyFileError> {
    match LargerModel::of_weights(array).filter(|_| field == "weights") {
        Some(model) => Err(BodyFileError::OtherModel { model: model.name, joints: model.n_joints }),
        None => Ok(()),
    }
}

/// Small numeric arrays of a pickled dictionary, by field; missing fields are left out.
///
/// # Errors
/// [`BodyFileError`] where the bytes are not such a dictionary or a field is not an array of at most a thousand numbers.
pub(crate) fn arrays_of_pickle(bytes: &[u8], names: &[&str]) -> Result<Fields, BodyFileError> {
    const MAX_SMALL: usize = 1000; // more than a camera calibration's field has
    dictionary_arrays(bytes, names, |_| MAX_SMALL, |_, _| Ok(()))
}

/// The arrays of `names` in a pickled dictionary, each of at most `limit` elements and checked before the next is read.
fn dictionary_arrays(
    bytes: &[u8],
    names: &[&str],
    limit: impl Fn(&str) -> usize,
    check: impl Fn(&str, &Array) -> Result<(), BodyFileError>,
) -> Result<Fields, BodyFileError> {
    let pickle = parse(bytes)?;
    let Node::Dict(entries) = &pickle.nodes[pickle.root] else {
        return Err(BodyFileError::Malformed { offset: bytes.len(), expected: "a dictionary of fields" });
    };
    let mut fields = Fields::new();
    let n_arrays = Cell::new(0);
    for field in names {
        if let Some(value) = lookup(&pickle, entries, field) {
            let reader = Reader { pickle: &pickle, field, n_arrays: &n_arrays };
            let (array, limit) = (reader.array(value, 0)?, limit(field));
            if array.values.len() > limit {
                return Err(BodyFileError::TooLarge { what: "an array", limit: limit as u64 });
            }
            check(field, &array)?;
            fields.insert((*field).to_owned(), array);
        }
    }
    Ok(fields)
}

fn lookup(pickle: &Pickle, entries: &[(NodeId, NodeId)], key: &str) -> Option<NodeId> {
    let is_key = |id: NodeId| match &pickle.nodes[id] {
        Node::Text(text) => text == key,
        Node::Bytes(bytes) => bytes.as_ref() == key.as_bytes(),
        _ => false,
    };
    entries.iter().rev().find(|(id, _)| is_key(*id)).map(|(_, value)| *value)
}

/// Reads the value of one field.
#[derive(Clone, Copy)]
struct Reader<'p, 'b> {
    pickle: &'p Pickle<'b>,
    field: &'p str,
    /// Arrays of the file that were read so far.
    n_arrays: &'p Cell<usize>,
}

/// A Python object: its class, arguments and state.
struct Object {
    class: Global,
    arguments: NodeId,
    state: Option<NodeId>,
}

impl<'p> Reader<'p, '_> {
    fn fault(&self, expected: &'static str) -> BodyFileError {
        BodyFileError::NotAnArray { field: self.field.to_owned(), expected }
    }

    /// Counts an array that is read.
    fn count_array(&self) -> Result<(), BodyFileError> {
        self.n_arrays.set(self.n_arrays.get() + 1);
        let limit = MAX_ARRAYS as u64;
        let is_within = self.n_arrays.get() <= MAX_ARRAYS;
        is_within.then_some(()).ok_or(BodyFileError::TooLarge { what: "the number of the pickle's arrays", limit })
    }

    fn array(&self, id: NodeId, depth: usize) -> Result<Array, BodyFileError> {
        self.count_array()?;
        if depth > MAX_DEPTH {
            return Err(self.fault("a value that does not contain itself"));
        }
        let object = self.object(id)?;
        match object.class {
            Global::ArrayReconstruct | Global::NdArray => self.numpy_array(&object),
            Global::Csc => self.sparse(&object, depth, Compressed::Columns),
            Global::Csr => self.sparse(&object, depth, Compressed::Rows),
            Global::Ch => self.array(self.member(&object, "x")?, depth + 1),
            Global::Select => self.select(&object, depth),
            _ => Err(self.fault("an array, a sparse matrix, a chumpy Ch or Select")),
        }
    }

    /// An object's class and arguments, whether it was called, newly created or reconstructed.
    fn object(&self, id: NodeId) -> Result<Object, BodyFileError> {
        let Node::Object { callable, arguments, state } = &self.pickle.nodes[id] else {
            return Err(self.fault("an array"));
        };
        let Node::Global(class) = self.pickle.nodes[*callable] else { return Err(self.fault("a known class")) };
        let class = match class {
            Global::Reconstructor => match self.sequence(*arguments)?.first().map(|first| &self.pickle.nodes[*first]) {
                Some(Node::Global(class)) => *class,
                _ => return Err(self.fault("a known class")),
            },
            class => class,
        };
        Ok(Object { class, arguments: *arguments, state: *state })
    }

    fn sequence(&self, id: NodeId) -> Result<&'p [NodeId], BodyFileError> {
        match &self.pickle.nodes[id] {
            Node::Sequence(items) => Ok(items),
            _ => Err(self.fault("a tuple")),
        }
    }

    fn integer(&self, id: NodeId) -> Result<i64, BodyFileError> {
        match &self.pickle.nodes[id] {
            Node::Int(value) => Ok(*value),
            // A scalar's arguments: its type and its bytes.
            Node::Object { .. } => {
                let object = self.object(id)?;
                let (Global::Scalar, [dtype, bytes]) = (object.class, self.sequence(object.arguments)?) else {
                    return Err(self.fault("an integer"));
                };
                let header = Header { shape: Vec::new(), number: self.number_type(*dtype)?, is_fortran: false };
                Ok(self.decoded(header, &self.bytes(*bytes)?)?.values[0] as i64)
            }
            _ => Err(self.fault("an integer")),
        }
    }

    fn shape(&self, id: NodeId) -> Result<Vec<usize>, BodyFileError> {
        let length =
            |id: &NodeId| usize::try_from(self.integer(*id)?).map_err(|_| self.fault("lengths of at least zero"));
        match &self.pickle.nodes[id] {
            Node::Sequence(items) if items.len() > MAX_DIMENSIONS => Err(self.fault("at most 64 dimensions")),
            Node::Sequence(items) => items.iter().map(length).collect(),
            // chumpy's preferred shape may be an array. The count ends an array that is its own shape.
            Node::Object { .. } => {
                self.count_array()?;
                Ok(self.numpy_array(&self.object(id)?)?.values.iter().map(|v| *v as usize).collect())
            }
            _ => Ok(vec![length(&id)?]),
        }
    }

    /// Raw bytes, or the text by which Python 3 writes them (`_codecs.encode(text, 'latin1')`, or Latin-1 text itself).
    fn bytes(&self, id: NodeId) -> Result<Cow<'p, [u8]>, BodyFileError> {
        let latin1 = |text: &str| -> Result<Vec<u8>, BodyFileError> {
            text.chars().map(|c| u8::try_from(u32::from(c)).map_err(|_| self.fault("Latin-1 text"))).collect()
        };
        match &self.pickle.nodes[id] {
            Node::Bytes(bytes) => Ok(Cow::Borrowed(bytes)),
            Node::Text(text) => Ok(Cow::Owned(latin1(text)?)),
            Node::Object { .. } => {
                let object = self.object(id)?;
                match (object.class, self.sequence(object.arguments)?.first().map(|first| &self.pickle.nodes[*first])) {
                    (Global::Encode, Some(Node::Text(text))) => Ok(Cow::Owned(latin1(text)?)),
                    (Global::Encode, Some(Node::Bytes(bytes))) => Ok(Cow::Borrowed(bytes)),
                    _ => Err(self.fault("raw bytes")),
                }
            }
            _ => Err(self.fault("raw bytes")),
        }
    }

    /// State: (version, shape, dtype, is Fortran order, bytes).
    fn numpy_array(&self, object: &Object) -> Result<Array, BodyFileError> {
        let state = object.state.ok_or_else(|| self.fault("an array with contents"))?;
        let [_, shape, dtype, is_fortran, bytes] = self.sequence(state)? else {
            return Err(self.fault("numpy's state of an array"));
        };
        let (number, is_fortran) = (self.number_type(*dtype)?, self.integer(*is_fortran)? != 0);
        self.decoded(Header { shape: self.shape(*shape)?, number, is_fortran }, &self.bytes(*bytes)?)
    }

    fn decoded(&self, header: Header, bytes: &[u8]) -> Result<Array, BodyFileError> {
        Array::decode(header, bytes, MAX_ELEMENTS).map_err(|error| BodyFileError::of_array(self.field, error))
    }

    /// Arguments: (code, ...), state: (version, byte order, ...).
    fn number_type(&self, id: NodeId) -> Result<NumberType, BodyFileError> {
        let object = self.object(id)?;
        let numbers = || self.fault("an array of numbers");
        let (Global::DType, Some(code)) = (object.class, self.sequence(object.arguments)?.first()) else {
            return Err(numbers());
        };
        let order = match object.state {
            Some(state) => self.bytes(*self.sequence(state)?.get(1).ok_or_else(numbers)?)?,
            None => Cow::Borrowed(b"<".as_slice()),
        };
        let code = self.bytes(*code)?;
        let code = std::str::from_utf8(&code).map_err(|_| numbers())?;
        NumberType::parse(code, order.as_ref() == b">").ok_or_else(numbers)
    }

    fn member(&self, object: &Object, name: &str) -> Result<NodeId, BodyFileError> {
        let missing = || self.fault("an object with all its members");
        match &self.pickle.nodes[object.state.ok_or_else(missing)?] {
            Node::Dict(entries) => lookup(self.pickle, entries, name).ok_or_else(missing),
            _ => Err(missing()),
        }
    }

    fn sparse(&self, object: &Object, depth: usize, compressed: Compressed) -> Result<Array, BodyFileError> {
        let part = |name: &str| self.array(self.member(object, name)?, depth + 1);
        let (data, indices, starts) = (part("data")?, part("indices")?, part("indptr")?);
        let shape = self.member(object, "_shape").or_else(|_| self.member(object, "shape"))?;
        let shape = self.shape(shape)?;
        let faulty = || self.fault("a consistent sparse matrix");
        let (&[rows, columns], Some(count)) = (shape.as_slice(), n_elements(&shape, MAX_ELEMENTS)) else {
            return Err(faulty());
        };
        let n_lines = if compressed == Compressed::Columns { columns } else { rows };
        // Starts that fall would have the same entries read for many lines.
        let is_within = |start: &f64| (0.0..=data.values.len() as f64).contains(start);
        if starts.values.len() != n_lines + 1 || !starts.values.is_sorted() || !starts.values.iter().all(is_within) {
            return Err(faulty());
        }
        let mut values = vec![0.0; count];
        for line in 0..n_lines {
            let (from, to) = (starts.values[line] as usize, starts.values[line + 1] as usize);
            for k in from..to {
                let (Some(value), Some(index)) = (data.values.get(k), indices.values.get(k)) else {
                    return Err(faulty());
                };
                let index = *index as usize;
                let (row, column) = if compressed == Compressed::Columns { (index, line) } else { (line, index) };
                if row >= rows || column >= columns {
                    return Err(faulty());
                }
                values[row * columns + column] += value;
            }
        }
        Ok(Array { shape, values })
    }

    /// `a.ravel()[idxs].reshape(preferred_shape)`.
    fn select(&self, object: &Object, depth: usize) -> Result<Array, BodyFileError> {
        let source = self.array(self.member(object, "a")?, depth + 1)?;
        let chosen = self.array(self.member(object, "idxs")?, depth + 1)?;
        let shape = match self.member(object, "preferred_shape") {
            Ok(shape) => self.shape(shape)?,
            Err(_) => chosen.shape.clone(),
        };
        let element = |index: &f64| source.values.get(*index as usize).copied();
        let values: Option<Vec<f64>> = chosen.values.iter().map(element).collect();
        let values = values.ok_or_else(|| self.fault("choices within the array"))?;
        if n_elements(&shape, MAX_ELEMENTS) != Some(values.len()) {
            return Err(self.fault("as many choices as the shape says"));
        }
        Ok(Array { shape, values })
    }
}

/// Whether a sparse matrix is stored by columns or by rows.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Compressed {
    Columns,
    Rows,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `pickle.dumps(dict(x=value), protocol=2)`, written opcode by opcode; `value` writes the value's.
    fn read(value: impl Fn(&mut Vec<u8>)) -> Result<Vec<f64>, BodyFileError> {
        let mut bytes = b"\x80\x02}(X\x01\0\0\0x".to_vec();
        value(&mut bytes);
        bytes.extend(b"u.");
        Ok(arrays_of_pickle(&bytes, &["x"])?.remove("x").unwrap().values)
    }

    /// A numpy array of float64, whose shape `shape` writes; memorised as number 0.
    fn array_of_shape(bytes: &mut Vec<u8>, shape: &[u8], values: &[f64]) {
        bytes.extend(b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\nK\x00\x85U\x01btRq\0(K\x01");
        bytes.extend(shape);
        bytes.extend(b"cnumpy\ndtype\n(U\x02f8K\x00K\x01tR\x89U");
        bytes.push(8 * values.len() as u8);
        values.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
        bytes.extend(b"tb");
    }

    fn array(bytes: &mut Vec<u8>, values: &[f64]) {
        array_of_shape(bytes, &[b'(', b'K', values.len() as u8, b't'], values);
    }

    fn text(bytes: &mut Vec<u8>, text: &str) {
        bytes.extend([b'U', text.len() as u8]);
        bytes.extend(text.as_bytes());
    }

    /// Choices of choices, each of which refers twice to the one before.
    fn chain(bytes: &mut Vec<u8>, length: u8) {
        array(bytes, &[0.0]);
        for level in 1..=length {
            bytes.extend(b"0cchumpy.reordering\nSelect\n)\x81}(");
            for member in ["a", "idxs"] {
                text(bytes, member);
                bytes.extend([b'h', level - 1]);
            }
            bytes.extend([b'u', b'b', b'q', level]);
        }
    }

    /// The time doubled with every element: 4 s for 3 KB.
    #[test]
    fn arrays_that_refer_twice_to_one_took_exponential_time() {
        assert_eq!(read(|bytes| chain(bytes, 6)).unwrap(), [0.0]);
        let error = read(|bytes| chain(bytes, 60)).unwrap_err();
        assert!(error.to_string().contains("the number of the pickle's arrays is larger than the 256"), "{error}");
    }

    #[test]
    fn an_array_that_is_its_own_shape_overflowed_the_stack() {
        let error = read(|bytes| array_of_shape(bytes, b"h\0", &[1.0])).unwrap_err();
        assert!(matches!(error, BodyFileError::TooLarge { .. }), "{error}");
    }

    #[test]
    fn starts_of_a_sparse_matrix_do_not_fall() {
        let sparse = |starts: [f64; 4]| {
            read(|bytes| {
                bytes.extend(b"cscipy.sparse.csc\ncsc_matrix\n)\x81}(");
                for (name, values) in [("data", &[2.0, 3.0][..]), ("indices", &[0.0, 0.0]), ("indptr", &starts)] {
                    text(bytes, name);
                    array(bytes, values);
                }
                text(bytes, "_shape");
                bytes.extend(b"(K\x01K\x03tub");
            })
        };
        assert_eq!(sparse([0.0, 1.0, 1.0, 2.0]).unwrap(), [2.0, 0.0, 3.0]);
        for starts in [[0.0, 2.0, 0.0, 2.0], [0.0, 1.0, 2.0, 3.0], [-1.0, 0.0, 1.0, 2.0], [0.0, f64::NAN, 1.0, 2.0]] {
            let error = sparse(starts).unwrap_err().to_string();
            assert!(error.contains("a consistent sparse matrix"), "{starts:?}: {error}");
        }
    }
}
