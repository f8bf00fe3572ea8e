//! `scene.fbx`: binary FBX 7.4 with skeleton, skin and animation of all people; `<person>.humanik.fbx`, `<person>.mixamo.fbx`
//! and `<person>.unreal.fbx`: one person with the joint names of another program ([`super::joint_names`]).
//!
//! Centimetres, degrees, y up. All files have the same clock: keys for every frame of the take at `frame number / fps`. Joint
//! axes lie along the bones ([`super::rig`]); rotations of zero are the T-pose, in which the skin is bound. In `scene.fbx`
//! the names of joints have the person as namespace (`person_0:pelvis`), since programs rename repeated names.
//!
//! While a person is absent, the nearest pose is held and the models are invisible. Known limits: no cameras; the frames in
//! which no camera detected the person are not marked (`people.json` lists them).

mod animation;
mod document;
mod mesh;
mod node;
mod objects;
mod person;
mod skeleton;

#[cfg(test)]
mod read_back;
#[cfg(test)]
mod tests;

use super::files::ResultFiles;
use super::joint_names::profiles;
use super::names::person_name;
use super::rig::Rig;
use super::skin::skin_mesh;
use super::take::Take;
use crate::session::recording::UpAxis;
use objects::{Objects, SCENE};
use person::Person;
use std::io;

const MEDIA_TYPE: &str = "application/octet-stream";

/// Writes a file of all people, and a file per person and set of joint names.
pub(super) fn write(files: &mut ResultFiles, take: &Take) -> io::Result<()> {
    let take = take.with_up_axis(UpAxis::Y);
    let names: Vec<String> = take.motions.iter().map(|motion| person_name(&take, motion)).collect();
    let person = |(motion, name)| {
        let rig = Rig::of(motion);
        Person { name, joint_names: rig.names.iter().map(|joint| format!("{name}:{joint}")).collect(), motion, rig }
    };
    let people: Vec<Person> = take.motions.iter().zip(names.iter().map(String::as_str)).map(person).collect();
    files.bytes("scene.fbx", MEDIA_TYPE, &scene(&take, &people)?)?;
    for mut person in people {
        for profile in profiles(&person.rig).into_iter().filter(|profile| !profile.suffix.is_empty()) {
            person.joint_names = profile.names;
            let file_name = format!("{}{}.fbx", person.motion.person.0, profile.suffix);
            files.bytes(&file_name, MEDIA_TYPE, &scene(&take, std::slice::from_ref(&person))?)?;
        }
    }
    Ok(())
}

fn scene(take: &Take, people: &[Person<'_>]) -> io::Result<Vec<u8>> {
    let mut objects = Objects::default();
    let animation = animation::add_animation(&mut objects, take);
    for person in people {
        let models = skeleton::add_models(&mut objects, person, SCENE);
        animation.add_motion(&mut objects, take, person, &models);
        animation.add_visibility(&mut objects, person, models.root);
        if let Some(body) = &take.body {
            let mesh = skin_mesh(body, person.motion);
            let model = mesh::add_mesh(&mut objects, person, &models, &mesh);
            animation.add_visibility(&mut objects, person, model);
        }
    }
    node::file(&document::document(take, objects))
}
