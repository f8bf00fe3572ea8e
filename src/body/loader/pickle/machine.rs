//! The opcodes of pickle protocols 0 to 4.

use super::escapes::{raw_unicode_unescaped, repr_unescaped};
use super::node::{Global, Node, NodeId};
use crate::body::loader::error::BodyFileError;
use std::borrow::Cow;

/// Whether opcodes follow.
#[derive(PartialEq, Eq)]
pub(super) enum Step {
    /// Opcodes follow.
    More,
    /// The pickle ended with STOP.
    Done,
}

/// The stack machine that executes a pickle's opcodes; it creates nodes only.
pub(super) struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    /// All nodes so far.
    pub nodes: Vec<Node<'a>>,
    stack: Vec<NodeId>,
    /// Heights of the stack at open marks.
    marks: Vec<usize>,
    memo: Vec<Option<NodeId>>,
}

type Outcome<T> = Result<T, BodyFileError>;

impl<'a> Machine<'a> {
    /// A machine before the first opcode.
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0, nodes: Vec::new(), stack: Vec::new(), marks: Vec::new(), memo: Vec::new() }
    }

    /// Runs one opcode.
    pub(super) fn step(&mut self) -> Outcome<Step> {
        let opcode = self.take(1)?[0];
        match opcode {
            b'.' => return Ok(Step::Done),
            0x80 => self.protocol()?,
            0x95 => drop(self.take(8)?), // FRAME: a hint for stream readers
            b'(' => self.marks.push(self.stack.len()),
            b'0' => drop(self.pop()?),
            b'1' => drop(self.pop_mark()?),
            b'2' => self.stack.push(self.top()?),
            b'N' => self.push(Node::None),
            0x88 | 0x89 => self.push(Node::Int(i64::from(opcode == 0x88))),
            b'I' | b'L' => self.decimal_int()?,
            b'J' => self.little_int(4, true)?,
            b'K' => self.little_int(1, false)?,
            b'M' => self.little_int(2, false)?,
            0x8a => self.long(1)?,
            0x8b => self.long(4)?,
            b'F' => self.decimal_float()?,
            b'G' => self.binary_float()?,
            b'S' => self.quoted_string()?,
            b'T' | b'B' => self.sized_bytes(4)?,
            b'U' | b'C' => self.sized_bytes(1)?,
            0x8e => self.sized_bytes(8)?,
            b'V' => self.escaped_text()?,
            b'X' => self.sized_text(4)?,
            0x8c => self.sized_text(1)?,
            0x8d => self.sized_text(8)?,
            b')' | b']' => self.push(Node::Sequence(Vec::new())),
            b'}' => self.push(Node::Dict(Vec::new())),
            0x8f => self.push(Node::None),  // EMPTY_SET
            0x90 => drop(self.pop_mark()?), // ADDITEMS, to a set
            b't' | b'l' => self.sequence_from_mark()?,
            0x85..=0x87 => self.tuple(usize::from(opcode - 0x84))?,
            b'd' => self.dict_from_mark()?,
            b'a' => {
                let item = self.pop()?;
                self.append(vec![item])?;
            }
            b'e' => {
                let items = self.pop_mark()?;
                self.append(items)?;
            }
            b's' => {
                let (value, key) = (self.pop()?, self.pop()?);
                self.set_items(vec![key, value])?;
            }
            b'u' => {
                let items = self.pop_mark()?;
                self.set_items(items)?;
            }
            b'p' => {
                let index = self.line_number()?;
                self.memorise(index)?;
            }
            b'q' => {
                let index = self.little(1)?;
                self.memorise(index)?;
            }
            b'r' => {
                let index = self.little(4)?;
                self.memorise(index)?;
            }
            0x94 => self.memorise(self.memo.len())?,
            b'g' => {
                let index = self.line_number()?;
                self.recall(index)?;
            }
            b'h' => {
                let index = self.little(1)?;
                self.recall(index)?;
            }
            b'j' => {
                let index = self.little(4)?;
                self.recall(index)?;
            }
            b'c' => {
                let (module, name) = (self.line_text()?, self.line_text()?);
                self.global(&module, &name)?;
            }
            0x93 => self.stack_global()?,
            b'R' | 0x81 => self.call()?,
            b'b' => self.build()?,
            _ => return Err(self.expected("an opcode of pickle protocols 0 to 4")),
        }
        Ok(Step::More)
    }

    fn expected(&self, expected: &'static str) -> BodyFileError {
        BodyFileError::Malformed { offset: self.at, expected }
    }

    fn take(&mut self, n: usize) -> Outcome<&'a [u8]> {
        let end = self.at.checked_add(n).filter(|end| *end <= self.bytes.len());
        let end = end.ok_or_else(|| self.expected("more of the pickle"))?;
        let taken = &self.bytes[self.at..end];
        self.at = end;
        Ok(taken)
    }

    fn line(&mut self) -> Outcome<&'a [u8]> {
        let length = self.bytes[self.at..].iter().position(|b| *b == b'\n');
        let length = length.ok_or_else(|| self.expected("the end of a line"))?;
        let line = self.take(length)?;
        self.at += 1;
        Ok(line)
    }

    fn line_text(&mut self) -> Outcome<Cow<'a, str>> {
        Ok(String::from_utf8_lossy(self.line()?))
    }

    fn line_number(&mut self) -> Outcome<usize> {
        self.line_text()?.trim().parse().map_err(|_| self.expected("a number before this"))
    }

    fn little(&mut self, n: usize) -> Outcome<usize> {
        let word = self.take(n)?;
        let value = word.iter().rev().fold(0_u64, |value, byte| value << 8 | u64::from(*byte));
        usize::try_from(value).map_err(|_| self.expected("a length of this machine"))
    }

    fn push(&mut self, node: Node<'a>) {
        self.stack.push(self.nodes.len());
        self.nodes.push(node);
    }

    fn top(&self) -> Outcome<NodeId> {
        self.stack.last().copied().ok_or_else(|| self.expected("a value on the stack"))
    }

    /// Takes the value on top of the stack, not below the last mark.
    pub(super) fn pop(&mut self) -> Outcome<NodeId> {
        let floor = self.marks.last().copied().unwrap_or(0);
        let top = if self.stack.len() > floor { self.stack.pop() } else { None };
        top.ok_or_else(|| self.expected("a value on the stack"))
    }

    fn pop_mark(&mut self) -> Outcome<Vec<NodeId>> {
        let height = self.marks.pop().ok_or_else(|| self.expected("a mark on the stack"))?;
        Ok(self.stack.split_off(height.min(self.stack.len())))
    }

    fn protocol(&mut self) -> Outcome<()> {
        match self.take(1)?[0] {
            0..=4 => Ok(()),
            _ => Err(self.expected("pickle protocol 0 to 4 before this")),
        }
    }

    fn decimal_int(&mut self) -> Outcome<()> {
        let line = self.line_text()?;
        let value = line.trim_end_matches('L').parse().map_err(|_| self.expected("an integer before this"))?;
        self.push(Node::Int(value));
        Ok(())
    }

    fn little_int(&mut self, n: usize, is_signed: bool) -> Outcome<()> {
        let value = self.little(n)? as i64;
        self.push(Node::Int(if is_signed { i64::from(value as u32 as i32) } else { value }));
        Ok(())
    }

    /// A little-endian two's complement integer; one of more than 64 bits becomes `None`, since no field contains it.
    fn long(&mut self, length_size: usize) -> Outcome<()> {
        let length = self.little(length_size)?;
        let word = self.take(length)?;
        let sign = if word.last().is_some_and(|b| b & 0x80 != 0) { -1_i64 } else { 0 };
        let fits = word.len() <= 8;
        let value = word.iter().rev().take(8).fold(sign, |value, byte| value << 8 | i64::from(*byte));
        self.push(if fits { Node::Int(value) } else { Node::None });
        Ok(())
    }

    fn decimal_float(&mut self) -> Outcome<()> {
        let value = self.line_text()?.trim().parse().map_err(|_| self.expected("a number before this"))?;
        self.push(Node::Float(value));
        Ok(())
    }

    fn binary_float(&mut self) -> Outcome<()> {
        let bits = self.take(8)?.iter().fold(0_u64, |bits, byte| bits << 8 | u64::from(*byte));
        self.push(Node::Float(f64::from_bits(bits)));
        Ok(())
    }

    fn sized_bytes(&mut self, length_size: usize) -> Outcome<()> {
        let length = self.little(length_size)?;
        let bytes = self.take(length)?;
        self.push(Node::Bytes(Cow::Borrowed(bytes)));
        Ok(())
    }

    fn sized_text(&mut self, length_size: usize) -> Outcome<()> {
        let length = self.little(length_size)?;
        let text = std::str::from_utf8(self.take(length)?).map_err(|_| self.expected("text in UTF-8 before this"))?;
        self.push(Node::Text(Cow::Borrowed(text)));
        Ok(())
    }

    /// A Python 2 string as its `repr`.
    fn quoted_string(&mut self) -> Outcome<()> {
        let line = self.line()?;
        let quote = *line.first().ok_or_else(|| self.expected("a quoted string before this"))?;
        let inner = line.get(1..line.len() - 1).filter(|_| line.len() > 1 && line.last() == Some(&quote));
        let inner = inner.ok_or_else(|| self.expected("a quoted string before this"))?;
        let bytes = repr_unescaped(inner).ok_or_else(|| self.expected("known escapes in the string before this"))?;
        self.push(Node::Bytes(Cow::Owned(bytes)));
        Ok(())
    }

    fn escaped_text(&mut self) -> Outcome<()> {
        let text = raw_unicode_unescaped(self.line()?);
        self.push(Node::Text(Cow::Owned(text)));
        Ok(())
    }

    fn sequence_from_mark(&mut self) -> Outcome<()> {
        let items = self.pop_mark()?;
        self.push(Node::Sequence(items));
        Ok(())
    }

    fn tuple(&mut self, n: usize) -> Outcome<()> {
        let mut items = Vec::with_capacity(n);
        for _ in 0..n {
            items.push(self.pop()?);
        }
        items.reverse();
        self.push(Node::Sequence(items));
        Ok(())
    }

    fn dict_from_mark(&mut self) -> Outcome<()> {
        let items = self.pop_mark()?;
        self.push(Node::Dict(Vec::new()));
        self.set_items(items)
    }

    fn append(&mut self, items: Vec<NodeId>) -> Outcome<()> {
        let top = self.top()?;
        match &mut self.nodes[top] {
            Node::Sequence(list) => list.extend(items),
            _ => return Err(self.expected("a list to append to")),
        }
        Ok(())
    }

    fn set_items(&mut self, items: Vec<NodeId>) -> Outcome<()> {
        let top = self.top()?;
        match &mut self.nodes[top] {
            Node::Dict(dict) => dict.extend(items.chunks_exact(2).map(|pair| (pair[0], pair[1]))),
            // A subclass of dict is filled the same way; fields do not use one.
            Node::Object { .. } => {}
            _ => return Err(self.expected("a dictionary to fill")),
        }
        Ok(())
    }

    fn memorise(&mut self, index: usize) -> Outcome<()> {
        const MAX_MEMO: usize = 100_000;
        if index >= MAX_MEMO {
            return Err(BodyFileError::TooLarge { what: "the pickle's memo", limit: MAX_MEMO as u64 });
        }
        let top = self.top()?;
        if self.memo.len() <= index {
            self.memo.resize(index + 1, None);
        }
        self.memo[index] = Some(top);
        Ok(())
    }

    fn recall(&mut self, index: usize) -> Outcome<()> {
        let node = self.memo.get(index).copied().flatten();
        self.stack.push(node.ok_or_else(|| self.expected("a remembered value before this"))?);
        Ok(())
    }

    fn global(&mut self, module: &str, name: &str) -> Outcome<()> {
        let forbidden = || BodyFileError::ForbiddenGlobal { module: module.to_owned(), name: name.to_owned() };
        let global = Global::named(module, name).ok_or_else(forbidden)?;
        self.push(Node::Global(global));
        Ok(())
    }

    fn stack_global(&mut self) -> Outcome<()> {
        let (name, module) = (self.pop()?, self.pop()?);
        let (Node::Text(module), Node::Text(name)) = (self.nodes[module].clone(), self.nodes[name].clone()) else {
            return Err(self.expected("a module and a name before this"));
        };
        self.global(&module, &name)
    }

    fn call(&mut self) -> Outcome<()> {
        let (arguments, callable) = (self.pop()?, self.pop()?);
        if !matches!(self.nodes[callable], Node::Global(_)) {
            return Err(self.expected("a known class before this"));
        }
        self.push(Node::Object { callable, arguments, state: None });
        Ok(())
    }

    fn build(&mut self) -> Outcome<()> {
        let (new_state, top) = (self.pop()?, self.top()?);
        match &mut self.nodes[top] {
            Node::Object { state, .. } => *state = Some(new_state),
            _ => return Err(self.expected("an object to set the state of")),
        }
        Ok(())
    }
}
