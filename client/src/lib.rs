//! Tombolo's viewer, as a library.
//!
//! The core draws what a [`feed`] brings and needs no thread, clock or file: [`camera`], [`scene`],
//! [`world`] (resident chunks and what to draw of them), [`frame`] (what the GPU is told),
//! [`render`] (how it draws), [`voyage`] (the driver that links them).
//!
//! The edge belongs to the native program: [`headless`] (pictures without a window), [`native`]
//! (options, sockets, files, the window).

#![forbid(unsafe_code)]

pub mod camera;
pub mod feed;
pub mod frame;
pub mod headless;
pub mod looks;
pub mod native;
pub mod plants;
pub mod relief;
pub mod render;
pub mod scene;
pub mod shadow;
pub mod stats;
pub mod voyage;
pub mod world;
