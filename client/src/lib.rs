//! Tombolo's viewer, as a library.
//!
//! Layers, lowest first; no module imports from a layer above its own:
//!
//! | module | job |
//! | --- | --- |
//! | [`camera`] | poses, projections, camera movement |
//! | [`gpu`] | device, pipelines, bind groups, render targets, read-back |
//! | [`cache`] | resident chunks: fixed slots, least-recently-used eviction |
//! | [`frustum`], [`lod`] | what may be in view; chunk selection, geometric error, geomorphing |
//! | [`features`] | terrain, shadows, vegetation, parallax, water, atmosphere, materials |
//! | [`settings`], [`view`], [`lighting`], [`scene`] | inputs of a frame |
//! | [`frame`] | GPU input of one frame, computed on the CPU |
//! | [`stream`] | chunk streams and the streamer between stream and cache |
//! | [`renderer`] | passes of a frame, in order |
//! | [`headless`], [`native`] | programs: options, sockets, files, window |
//!
//! Everything below `headless` needs no thread, clock or file.

#![forbid(unsafe_code)]

pub mod cache;
pub mod camera;
pub mod features;
pub mod frame;
pub mod frustum;
pub mod gpu;
pub mod headless;
pub mod lighting;
pub mod lod;
pub mod native;
pub mod renderer;
pub mod scene;
pub mod settings;
pub mod stats;
pub mod stream;
pub mod view;
