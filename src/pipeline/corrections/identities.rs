//! People after corrections: their detections, names and heights, and what is left out.

use super::{Correction, CorrectionError};
use crate::session::recording::{FrameIndex, PersonId};
use crate::session::{PersonTrack, Session};
use std::collections::{BTreeMap, BTreeSet};

/// Longest name of a person, characters.
const MAX_NAME_CHARS: usize = 64;

/// People after corrections.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CorrectedPeople {
    /// In ascending order of their numbers.
    pub tracks: Vec<PersonTrack>,
    /// Detections that are left out: indices of view, frame and detection.
    pub excluded: BTreeSet<[usize; 3]>,
    /// Views that are left out.
    pub excluded_views: BTreeSet<usize>,
    /// Names by person.
    pub names: BTreeMap<PersonId, String>,
    /// Known heights by person, m.
    pub heights: BTreeMap<PersonId, f64>,
}

/// Applies `corrections` to the people of `tracks`, which the solve of `session` without corrections found.
///
/// # Errors
/// [`CorrectionError`] for the first correction that names an unknown person, a frame outside, or contradicts an earlier one.
pub fn corrected_people(
    session: &Session,
    tracks: &[PersonTrack],
    corrections: &[Correction],
) -> Result<CorrectedPeople, CorrectionError> {
    let mut edit = Edit::new(session, tracks);
    for (i, correction) in corrections.iter().enumerate() {
        edit.apply(i, correction).map_err(|reason| correction.error(i, reason))?;
    }
    let last = corrections.len().saturating_sub(1);
    match corrections.last().filter(|_| edit.people.is_empty()) {
        Some(correction) => Err(correction.error(last, "no person is left; leave at least one in".to_owned())),
        None => Ok(edit.result()),
    }
}

impl CorrectedPeople {
    /// The session in which the detections that are left out have no keypoint.
    pub fn without_excluded(&self, session: &Session) -> Session {
        let mut left = session.clone();
        for &[view, frame, detection] in &self.excluded {
            left.views[view].frames[frame][detection].keypoints.iter_mut().for_each(|k| k.confidence = 0.0);
        }
        left
    }
}

/// Detections of a person by frame: an index for each view.
type Detections = BTreeMap<usize, Vec<Option<usize>>>;

/// The people while corrections are applied.
struct Edit<'a> {
    session: &'a Session,
    people: BTreeMap<usize, Detections>,
    next_number: usize,
    /// Why a person was removed.
    gone: BTreeMap<usize, String>,
    result: CorrectedPeople,
}

impl<'a> Edit<'a> {
    fn new(session: &'a Session, tracks: &[PersonTrack]) -> Self {
        let detections = |track: &PersonTrack| -> Detections {
            let frames = track.detections.iter().enumerate().map(|(t, seen)| (track.first.0 + t, seen.clone()));
            frames.filter(|(_, seen)| seen.iter().any(Option::is_some)).collect()
        };
        let people: BTreeMap<usize, Detections> =
            tracks.iter().map(|track| (track.person.0, detections(track))).collect();
        let next_number = people.keys().next_back().map_or(0, |last| last + 1);
        Self { session, people, next_number, gone: BTreeMap::new(), result: CorrectedPeople::default() }
    }

    fn apply(&mut self, index: usize, correction: &Correction) -> Result<(), String> {
        match correction {
            Correction::Rename { person, name } => self.rename(*person, name),
            Correction::Merge { people } => self.merge(index, people),
            Correction::Split { person, frame } => self.split(*person, *frame),
            Correction::Exchange { people, frame, last_frame } => self.exchange(*people, *frame, *last_frame),
            Correction::ExcludeCamera { camera } => self.exclude_camera(index, camera),
            Correction::ExcludePerson { person } => self.exclude_person(index, *person),
            Correction::ExcludeFrames { frames, camera, person } => {
                self.exclude_frames(*frames, camera.as_deref(), *person)
            }
            Correction::SetHeight { person, metres } => {
                self.known(*person)?;
                match self.result.heights.insert(PersonId(*person), *metres) {
                    Some(_) => Err(format!("person {person} has a height already; state it once")),
                    None => Ok(()),
                }
            }
        }
    }

    fn rename(&mut self, person: usize, name: &str) -> Result<(), String> {
        self.known(person)?;
        if name.trim() != name
            || name.is_empty()
            || name.chars().count() > MAX_NAME_CHARS
            || name.contains(char::is_control)
        {
            return Err(format!(
                "{name:?} is not a name; give 1 to {MAX_NAME_CHARS} characters without spaces at the ends"
            ));
        }
        if let Some((other, _)) = self.result.names.iter().find(|(_, taken)| *taken == name) {
            return Err(format!("person {} has the name {name:?} already; give each person its own", other.0));
        }
        match self.result.names.insert(PersonId(person), name.to_owned()) {
            Some(before) => Err(format!("person {person} was named {before:?} before; name it once")),
            None => Ok(()),
        }
    }

    fn merge(&mut self, index: usize, people: &[usize]) -> Result<(), String> {
        let [first, others @ ..] = people else { return Err("no person is named; name two or more".to_owned()) };
        if others.is_empty() || people.iter().collect::<BTreeSet<_>>().len() < people.len() {
            return Err("two different people or more are needed; name each once".to_owned());
        }
        people.iter().try_for_each(|person| self.known(*person))?;
        for other in others {
            let moved = self.people.get(other).cloned().unwrap_or_default();
            if let Some((frame, view)) = self.people.get(first).and_then(|own| seen_twice(own, &moved)) {
                return Err(format!(
                    "camera {} shows both person {first} and person {other} in frame {}; they are two people, or the detections \
                     of one of them there are to be left out first with exclude_frames",
                    self.session.views[view].id,
                    self.session.frame_number(FrameIndex(frame))
                ));
            }
            self.add(*first, moved);
            self.remove(*other, format!("correction {} merged it into person {first}", index + 1));
        }
        Ok(())
    }

    fn split(&mut self, person: usize, frame: i64) -> Result<(), String> {
        let (own, at) = (self.known_detections(person)?, self.frame_index(frame)?);
        let (first, last) = ends(own);
        if !(first + 1..=last).contains(&at) {
            let [from, to] = [first + 1, last].map(|f| self.session.frame_number(FrameIndex(f)));
            return Err(format!(
                "person {person} has no part on one side of frame {frame}; choose a frame from {from} to {to}"
            ));
        }
        let later = self.people.get_mut(&person).map(|own| own.split_off(&at)).unwrap_or_default();
        self.people.insert(self.next_number, later);
        self.next_number += 1;
        Ok(())
    }

    fn exchange(&mut self, people: [usize; 2], frame: i64, last_frame: Option<i64>) -> Result<(), String> {
        if people[0] == people[1] {
            return Err("two different people are needed".to_owned());
        }
        people.iter().try_for_each(|person| self.known(*person))?;
        let range = self.frame_range([frame, last_frame.unwrap_or(self.last_number())])?;
        let parts = people.map(|person| self.take(person, &range));
        if parts.iter().all(BTreeMap::is_empty) {
            return Err(format!(
                "neither person {} nor person {} was detected there; choose other frames",
                people[0], people[1]
            ));
        }
        let [one, other] = parts;
        self.add(people[0], other);
        self.add(people[1], one);
        match people.into_iter().find(|person| self.people.get(person).is_none_or(BTreeMap::is_empty)) {
            Some(empty) => Err(format!("nothing is left of person {empty}; merge the two people instead")),
            None => Ok(()),
        }
    }

    fn exclude_camera(&mut self, index: usize, camera: &str) -> Result<(), String> {
        let view = self.view(camera)?;
        self.result.excluded_views.insert(view);
        let n_left = self.session.views.len() - self.result.excluded_views.len();
        if n_left < 2 {
            return Err(format!("{n_left} cameras would be left; leave at least two in"));
        }
        let frames = self.session.views[view].frames.iter().enumerate();
        self.result.excluded.extend(frames.flat_map(|(f, people)| (0..people.len()).map(move |d| [view, f, d])));
        self.forget_excluded();
        // Those that no other camera shows would stand in the way of the corrections that follow.
        let unseen: Vec<usize> =
            self.people.iter().filter(|(_, seen)| seen.is_empty()).map(|(person, _)| *person).collect();
        for person in unseen {
            self.remove(person, format!("correction {} left out the only camera that showed this person", index + 1));
        }
        Ok(())
    }

    fn exclude_person(&mut self, index: usize, person: usize) -> Result<(), String> {
        let own = self.known_detections(person)?.clone();
        self.result.excluded.extend(places(&own));
        self.remove(person, format!("correction {} left it out", index + 1));
        Ok(())
    }

    fn exclude_frames(&mut self, frames: [i64; 2], camera: Option<&str>, person: Option<usize>) -> Result<(), String> {
        let range = self.frame_range(frames)?;
        let view = camera.map(|camera| self.view(camera)).transpose()?;
        let found: Vec<[usize; 3]> = match person {
            Some(person) => places(self.known_detections(person)?).collect(),
            None => {
                let views = self.session.views.iter().enumerate();
                let frames = views
                    .flat_map(|(v, view)| view.frames.iter().enumerate().map(move |(f, people)| (v, f, people.len())));
                frames.flat_map(|(v, f, n)| (0..n).map(move |d| [v, f, d])).collect()
            }
        };
        let is_meant = |[v, f, _]: &[usize; 3]| range.contains(f) && view.is_none_or(|view| view == *v);
        let n_before = self.result.excluded.len();
        self.result.excluded.extend(found.into_iter().filter(is_meant));
        if self.result.excluded.len() == n_before {
            return Err("nothing was detected there, or it was left out before; choose other frames".to_owned());
        }
        self.forget_excluded();
        match self.people.iter().find(|(_, detections)| detections.is_empty()) {
            Some((empty, _)) => Err(format!("nothing would be left of person {empty}; use exclude_person")),
            None => Ok(()),
        }
    }

    /// Removes the detections that are left out from all people.
    fn forget_excluded(&mut self) {
        for detections in self.people.values_mut() {
            for (frame, seen) in detections.iter_mut() {
                for (view, detection) in seen.iter_mut().enumerate() {
                    if detection.is_some_and(|d| self.result.excluded.contains(&[view, *frame, d])) {
                        *detection = None;
                    }
                }
            }
            detections.retain(|_, seen| seen.iter().any(Option::is_some));
        }
    }

    fn known(&self, person: usize) -> Result<(), String> {
        self.known_detections(person).map(|_| ())
    }

    fn known_detections(&self, person: usize) -> Result<&Detections, String> {
        self.people.get(&person).ok_or_else(|| match self.gone.get(&person) {
            Some(why) => format!("person {person} was removed: {why}"),
            None => {
                let numbers: Vec<String> = self.people.keys().map(usize::to_string).collect();
                format!("person {person} does not exist; the people are {}", numbers.join(", "))
            }
        })
    }

    fn view(&self, camera: &str) -> Result<usize, String> {
        let view = self.session.views.iter().position(|view| view.id == camera);
        let view = view.ok_or_else(|| format!("the session has no camera {camera:?}; name one of its cameras"))?;
        match self.result.excluded_views.contains(&view) {
            true => Err(format!("camera {camera:?} was left out before; name it once")),
            false => Ok(view),
        }
    }

    fn last_number(&self) -> i64 {
        self.session.frame_number(FrameIndex(self.session.n_frames.saturating_sub(1)))
    }

    fn frame_index(&self, number: i64) -> Result<usize, String> {
        let [first, last] = [self.session.first_frame, self.last_number()];
        let index = (first..=last).contains(&number).then(|| number.abs_diff(first) as usize);
        index.ok_or_else(|| format!("frame {number} is outside of the recording; its frames are {first} to {last}"))
    }

    fn frame_range(&self, [first, last]: [i64; 2]) -> Result<std::ops::RangeInclusive<usize>, String> {
        let range = self.frame_index(first)?..=self.frame_index(last)?;
        if range.is_empty() {
            return Err(format!("the last frame {last} is before the first one {first}; exchange the two"));
        }
        Ok(range)
    }

    /// Takes a range of frames from a person.
    fn take(&mut self, person: usize, range: &std::ops::RangeInclusive<usize>) -> Detections {
        let own = self.people.remove(&person).unwrap_or_default();
        let (taken, left) = own.into_iter().partition(|(frame, _)| range.contains(frame));
        self.people.insert(person, left);
        taken
    }

    /// Adds detections to a person that has none in the same frame and view.
    fn add(&mut self, person: usize, more: Detections) {
        let own = self.people.entry(person).or_default();
        for (frame, seen) in more {
            let known = own.entry(frame).or_insert_with(|| vec![None; seen.len()]);
            known.iter_mut().zip(seen).for_each(|(known, new)| *known = known.or(new));
        }
    }

    fn remove(&mut self, person: usize, why: String) {
        self.people.remove(&person);
        self.result.names.remove(&PersonId(person));
        self.result.heights.remove(&PersonId(person));
        self.gone.insert(person, why);
    }

    fn result(self) -> CorrectedPeople {
        let n_views = self.session.views.len();
        let seen = self.people.iter().filter(|(_, detections)| !detections.is_empty());
        let track = |(person, detections): (&usize, &Detections)| {
            let (first, last) = ends(detections);
            let at = |frame: usize| detections.get(&frame).cloned().unwrap_or_else(|| vec![None; n_views]);
            PersonTrack {
                person: PersonId(*person),
                first: FrameIndex(first),
                detections: (first..=last).map(at).collect(),
            }
        };
        CorrectedPeople { tracks: seen.map(track).collect(), ..self.result }
    }
}

/// First and last frame.
fn ends(detections: &Detections) -> (usize, usize) {
    let first = detections.keys().next().copied().unwrap_or(0);
    (first, detections.keys().next_back().copied().unwrap_or(first))
}

/// Indices of view, frame and detection of all detections.
fn places(detections: &Detections) -> impl Iterator<Item = [usize; 3]> {
    let of_frame = |(frame, seen): (&usize, &Vec<Option<usize>>)| {
        let frame = *frame;
        let seen = seen.clone().into_iter().enumerate();
        seen.filter_map(move |(view, detection)| Some([view, frame, detection?]))
    };
    detections.iter().flat_map(of_frame)
}

/// The first frame and view in which both people have a detection.
fn seen_twice(one: &Detections, other: &Detections) -> Option<(usize, usize)> {
    other.iter().find_map(|(frame, seen)| {
        let views = one.get(frame)?.iter().zip(seen);
        let view = views.into_iter().position(|(a, b)| a.is_some() && b.is_some())?;
        Some((*frame, view))
    })
}
