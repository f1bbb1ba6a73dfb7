//! The land.
//!
//! This crate defines one thing: the integer height of every vertex of the world, and what follows
//! from it (chunks, height pyramids, grass seeds, level-of-detail choice). A server, a client and a
//! GPU that follow the same rules compute the same integers, so collision equals picture and a
//! chunk can be cached for ever.
//!
//! It has no input or output, clocks, threads, async, GPU, serialisation or float arithmetic (a
//! lint denies it outside tests; one square root of an integer is taken in f64 and corrected).
//! `unsafe` code is confined to [`simd`]. Generation cannot fail; the only errors are
//! [`OutsideWorld`], [`key::InvalidKey`], [`grid::InvalidGrid`] and [`octaves::TooManyOctaves`],
//! returned where raw numbers become a position, a key, a grid or a number of octaves.
//!
//! Reading order: [`constants`] (every number), [`ring`] (the allowed arithmetic), [`hash`],
//! [`weights`], [`octaves`], [`noise`], [`island`], [`land`] (the height of a point), [`grid`] and
//! [`simd`] (many points, fast), [`key`] (the quadtree), [`pyramid`], [`grass`],
//! [`random_attributes`], [`chunk`], [`digest`], [`lod`].

#![cfg_attr(not(test), deny(clippy::float_arithmetic, reason = "heights are integers on every machine"))]

pub mod base;
pub mod chunk;
pub mod constants;
pub mod curves;
pub mod digest;
pub mod grass;
pub mod grid;
pub mod hash;
pub mod island;
pub mod key;
pub mod land;
pub mod lattice;
pub mod lod;
pub mod noise;
pub mod octaves;
pub mod parameters;
pub mod position;
pub mod pyramid;
pub mod random_attributes;
pub mod ring;
mod shape;
pub mod simd;
pub mod spline;
pub mod start;
mod texels;
pub mod triangles;
pub mod weights;

pub use chunk::Chunk;
pub use digest::WorldDigest;
pub use grass::GrassSeed;
pub use grid::Grid;
pub use key::{ChunkKey, InvalidKey};
pub use land::Land;
pub use octaves::Octaves;
pub use parameters::Parameters;
pub use position::{OutsideWorld, Position};
pub use pyramid::Pyramid;
pub use simd::Kernel;
pub use start::Start;
