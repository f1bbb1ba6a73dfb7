//! `lod`: levels of detail as they are drawn, against the land that they stand for.

pub mod drawn;
pub mod screen;
