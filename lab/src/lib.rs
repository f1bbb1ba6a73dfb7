//! The measuring bench, behind `tombolo-lab`.
//!
//! Every promise about the land is measured here against a ground truth: [`digest`] (all backends
//! compute the same integers), [`accuracy`] (what every shortcut costs), [`mod@lod`] (what the
//! levels of detail draw), [`stability`] (the ends of the world), [`timings`] (GPU against CPU),
//! [`codec`] (chunks on the wire against other codecs).
//!
//! What it refuses: judging by eye. A measurement that does not hold its bar is an error, and the
//! exit code says so.

#![forbid(unsafe_code)]

pub mod accuracy;
pub mod adapters;
pub mod chart;
pub mod codec;
pub mod cracks;
pub mod culling;
pub mod digest;
pub mod flip;
pub mod floats;
pub mod lod;
pub mod options;
pub mod pom;
pub mod probe;
pub mod relief;
pub mod sample;
pub mod scenery;
pub mod stability;
pub mod studio;
pub mod table;
pub mod timings;
pub mod truth;
pub mod waves;

pub use options::{Args, Command, Outputs};

/// Says what takes time, where a person waits.
pub(crate) fn note(what: &str) {
    if std::io::IsTerminal::is_terminal(&std::io::stderr()) {
        eprintln!("measuring {what} ...");
    }
}
