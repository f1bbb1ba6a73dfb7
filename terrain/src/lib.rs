//! The land.
//!
//! This crate defines one thing: the integer height of every vertex of the world, and what follows from it
//! (chunks, height pyramids, grass seeds, level-of-detail choice). A server, a client and a GPU that follow
//! the same rules compute the same integers, so collision equals picture and a chunk can be cached for ever.
//!
//! What it refuses: input and output, clocks, threads, async, GPU, serialisation, `unsafe`, and floats on any
//! path that decides a height. Nothing in it fails; the only errors are [`OutsideWorld`] and
//! [`key::InvalidKey`], returned where a caller turns raw numbers into a position or a key.
//!
//! Reading order: [`constants`] (every number), [`ring`] (the allowed arithmetic), [`hash`], [`noise`],
//! [`island`], [`land`] (the height of a point), [`key`] (the quadtree), [`pyramid`], [`grass`], [`chunk`],
//! [`digest`], [`lod`].

#![forbid(unsafe_code)]

pub mod chunk;
pub mod constants;
pub mod digest;
pub mod grass;
pub mod hash;
pub mod island;
pub mod key;
pub mod land;
pub mod lod;
pub mod noise;
pub mod position;
pub mod pyramid;
pub mod ring;

pub use chunk::Chunk;
pub use digest::WorldDigest;
pub use grass::GrassSeed;
pub use key::{ChunkKey, InvalidKey};
pub use land::Land;
pub use position::{OutsideWorld, Position};
pub use pyramid::Pyramid;
