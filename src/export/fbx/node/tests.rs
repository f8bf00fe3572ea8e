//! Every record is written and read back by a parser of the published layout.

use super::super::read_back::{Record, read};
use super::*;

fn some_nodes() -> Vec<Node> {
    let all = vec![
        Property::Bool(true),
        Property::I32(-7),
        Property::I64(i64::MIN),
        Property::F64(0.1),
        Property::Text("pelvis\u{0}\u{1}Model".to_owned()),
        Property::Bytes(vec![0, 255, 13]),
        Property::I32s((-40..40).collect()),
        Property::I64s(vec![1, -1]),
        Property::F32s(vec![]),
        Property::F64s((0..100).map(f64::from).map(f64::sqrt).collect()),
    ];
    let inner = Node::new("Inner", all, vec![Node::leaf("Leaf", [Property::I32(1)]), Node::leaf("Empty", [])]);
    vec![Node::new("Outer", [], vec![inner.clone(), inner]), Node::leaf("Last", [Property::Text(String::new())])]
}

#[test]
fn records_read_back() {
    let nodes = some_nodes();
    let bytes = file(&nodes).unwrap();
    assert_eq!((&bytes[..23], &bytes[23..27]), (&MAGIC[..], &7400_u32.to_le_bytes()[..]));
    let (records, footer) = read(&bytes);
    assert_eq!(records, nodes.iter().map(Record::from).collect::<Vec<_>>());
    assert_eq!(bytes[footer..footer + 16], FOOTER_ID);
    let version = bytes.len() - 16 - 120 - 4;
    assert_eq!((version % 16, &bytes[version..version + 4]), (0, &7400_u32.to_le_bytes()[..]));
    assert!(bytes[footer + 16..version].iter().all(|byte| *byte == 0) && version - footer > 20);
    assert_eq!(bytes[bytes.len() - 16..], END);
}

#[test]
fn the_layout_of_a_record_is_the_published_one() {
    let mut bytes = vec![9; 3]; // positions count from the start of the file
    Node::leaf("Ab", [Property::I32(5)]).write(&mut bytes).unwrap();
    let expected: [&[u8]; 6] = [&[9; 3], &[23, 0, 0, 0], &[1, 0, 0, 0], &[5, 0, 0, 0], b"\x02Ab", b"I\x05\0\0\0"];
    assert_eq!(bytes, expected.concat());
}
