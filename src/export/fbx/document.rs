//! The sections of an FBX file around its objects: header, settings, definitions, takes.

use super::animation::{STACK_NAME, ticks};
use super::node::{CREATION_TIME, FILE_ID, Node, Property as P, VERSION};
use super::objects::{Objects, integer, properties, property, text};
use crate::export::take::Take;
use std::collections::BTreeMap;

/// Rates that FBX numbers; 14 stands for any other.
const TIME_MODES: [(f64, i32); 8] =
    [(120.0, 1), (100.0, 2), (60.0, 3), (50.0, 4), (48.0, 5), (30.0, 6), (25.0, 10), (24.0, 11)];
const CUSTOM_TIME_MODE: i32 = 14;
/// Number of the one document; no object has it.
const DOCUMENT: i64 = 999_999;
const CREATOR: &str = "wandless";

/// The records at the top of the file.
pub(super) fn document(take: &Take, objects: Objects) -> Vec<Node> {
    vec![
        header(),
        Node::leaf("FileId", [P::Bytes(FILE_ID.to_vec())]),
        Node::leaf("CreationTime", [text(CREATION_TIME)]),
        Node::leaf("Creator", [text(CREATOR)]),
        settings(take),
        documents(),
        Node::leaf("References", []),
        definitions(&objects),
        Node::new("Objects", [], objects.nodes),
        Node::new("Connections", [], objects.connections),
        takes(take),
    ]
}

fn header() -> Node {
    let moment = [("Version", 1000), ("Year", 1970), ("Month", 1), ("Day", 1), ("Hour", 10)];
    let rest = [("Minute", 0), ("Second", 0), ("Millisecond", 0)];
    let moment = moment.into_iter().chain(rest).map(|(name, value)| integer(name, value)).collect();
    let content = vec![
        integer("FBXHeaderVersion", 1003),
        integer("FBXVersion", VERSION as i32),
        integer("EncryptionType", 0),
        Node::new("CreationTimeStamp", [], moment),
        Node::leaf("Creator", [text(CREATOR)]),
    ];
    Node::new("FBXHeaderExtension", [], content)
}

/// y up, z towards the viewer, x to the right; one unit is a centimetre.
fn settings(take: &Take) -> Node {
    let [start, end] = take.frame_range().map(|frame| ticks(take, frame));
    let int = |name: &str, value: i32| property(name, "int", "Integer", "", [P::I32(value)]);
    let number = |name: &str, value: f64| property(name, "double", "Number", "", [P::F64(value)]);
    let time = |name: &str, at: i64| property(name, "KTime", "Time", "", [P::I64(at)]);
    let named = TIME_MODES.iter().find(|(fps, _)| (fps - take.fps).abs() < 1e-9);
    let time_mode = named.map_or(CUSTOM_TIME_MODE, |(_, mode)| *mode);
    let all = vec![
        int("UpAxis", 1),
        int("UpAxisSign", 1),
        int("FrontAxis", 2),
        int("FrontAxisSign", 1),
        int("CoordAxis", 0),
        int("CoordAxisSign", 1),
        int("OriginalUpAxis", 1),
        int("OriginalUpAxisSign", 1),
        number("UnitScaleFactor", 1.0),
        number("OriginalUnitScaleFactor", 1.0),
        property("TimeMode", "enum", "", "", [P::I32(time_mode)]),
        time("TimeSpanStart", start),
        time("TimeSpanStop", end),
        number("CustomFrameRate", take.fps),
    ];
    Node::new("GlobalSettings", [], vec![integer("Version", 1000), properties(all)])
}

fn documents() -> Node {
    let active = property("ActiveAnimStackName", "KString", "", "", [text(STACK_NAME)]);
    let content = vec![
        properties(vec![property("SourceObject", "object", "", "", []), active]),
        Node::leaf("RootNode", [P::I64(0)]),
    ];
    let scene = Node::new("Document", [P::I64(DOCUMENT), text("Scene"), text("Scene")], content);
    Node::new("Documents", [], vec![integer("Count", 1), scene])
}

/// How many objects of each type follow.
fn definitions(objects: &Objects) -> Node {
    let mut counts = BTreeMap::from([("GlobalSettings", 1)]);
    objects.nodes.iter().for_each(|node| *counts.entry(node.name).or_insert(0) += 1);
    let kind = |(name, count): (&&str, &i32)| Node::new("ObjectType", [text(name)], vec![integer("Count", *count)]);
    let total = integer("Count", counts.values().sum());
    Node::new("Definitions", [], [integer("Version", 100), total].into_iter().chain(counts.iter().map(kind)).collect())
}

fn takes(take: &Take) -> Node {
    let span = take.frame_range().map(|frame| P::I64(ticks(take, frame)));
    let content = vec![
        Node::leaf("FileName", [text("")]),
        Node::leaf("LocalTime", span.clone()),
        Node::leaf("ReferenceTime", span),
    ];
    let one = Node::new("Take", [text(STACK_NAME)], content);
    Node::new("Takes", [], vec![Node::leaf("Current", [text(STACK_NAME)]), one])
}
