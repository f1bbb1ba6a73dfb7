//! Reliefs under measurement: height maps that are hard to march over ([`maps`]), the truth in f64 ([`truth`]) and the shipped marches on this machine's GPU
//! ([`bench`]), and both compared ([`trial`]).

pub mod bench;
pub mod maps;
pub mod trial;
pub mod truth;
