//! Every shader against naga and Tint, every layout against reflection, and the controls that must
//! fail.

mod frame_layout;
mod land_layout;
mod plant_layout;
mod portability;
mod ring_profile;
mod surface_layout;

use crate::validate::validate;
use crate::{SHADERS, Shader, Stage};
use naga::TypeInner;

/// The passes of one kind.
fn passes(compute: bool) -> impl Iterator<Item = &'static Shader> {
    let computes = |shader: &&Shader| shader.entry_points.iter().all(|entry| entry.stage == Stage::Compute);
    SHADERS.all().into_iter().filter(move |shader| computes(shader) == compute)
}

/// Offsets of a struct's members and its size, as a shader reads them.
fn reflected(shader: &Shader, name: &str) -> (Vec<(String, usize)>, usize) {
    let (module, _) = validate(shader.name, shader.wgsl).unwrap();
    let (_, found) = module
        .types
        .iter()
        .find(|(_, candidate)| candidate.name.as_deref() == Some(name))
        .unwrap_or_else(|| panic!("{} has no {name}", shader.name));
    let TypeInner::Struct { members, span } = &found.inner else { panic!("{name} is no struct") };
    let member = |m: &naga::StructMember| (m.name.clone().unwrap_or_default(), m.offset as usize);
    (members.iter().map(member).collect(), *span as usize)
}

/// Asserts that a struct of a shader has the members of a Rust struct where that has them.
macro_rules! assert_same_layout {
    ($shader:expr, $type:ident, $($member:ident),+ $(,)?) => {
        let expected = vec![$((stringify!($member).to_owned(), offset_of!($type, $member))),+];
        let found = reflected(&$shader, stringify!($type));
        assert_eq!(found, (expected, size_of::<$type>()), "{}", $shader.name);
    };
}

use assert_same_layout;
