//! Reliefs under measurement: height maps that are hard to march over ([`maps`]), the truth in f64
//! ([`truth`]) and the shipped marches on this machine's GPU ([`mod@bench`]), both compared
//! ([`trial`]), and what pictures of reliefs say of their edges and depths ([`pictures`]).

pub mod bench;
pub mod maps;
pub mod pictures;
pub mod trial;
pub mod truth;
