//! `tombolo-lab visual`: what a person would notice in pictures of the land.
//!
//! Light across borders of chunks (`borders`; control: one side is brightened), the change of
//! shading with the tolerance (`tolerance`; control: normals of the drawn triangles), light in
//! shadow (`shadow`). The power spectrum of the ground (`spectrum`),
//! shadows of objects on floors (`floor_shadow`), near planes under lifted eyes (`near_plane`),
//! impostors of trees (`impostors`), shadows of trees (`tree_shadow`), times of frames
//! (`frame_time`). `cargo xtask measure visual` compares the figures with their bars; here only a
//! control that passes is an error.

mod bars;
mod borders;
mod floor_shadow;
mod frame_time;
mod impostors;
mod near_plane;
mod shadow;
mod spectrum;
mod tolerance;
mod tree_shadow;
mod views;

use crate::report::publish;
use crate::{Outputs, note};
use anyhow::{Result, ensure};
use serde::Serialize;
use terrain::Land;

/// The world that is measured.
const WORLD_SEED: u64 = 1;

/// Poses of a record, and the lifted eyes of one.
pub const POSES: u32 = 60;
const EYES: u32 = 200;

/// Options of `visual`.
#[derive(Clone, Debug, clap::Args)]
pub struct Options {
    /// Poses of each figure, 4 to 10000
    #[arg(long, value_name = "N", default_value_t = POSES,
          value_parser = clap::value_parser!(u32).range(4..=10_000))]
    pub poses: u32,
}

/// The result. Field names are a contract with scripts.
#[derive(Clone, Debug, Serialize)]
struct Report {
    adapter: String,
    poses: u32,
    borders: borders::Borders,
    tolerance: tolerance::Tolerance,
    shadow: shadow::Shadow,
    spectrum: spectrum::Spectrum,
    /// Pixels of all pictures above with light that is no finite number.
    unlit: u64,
    floor: floor_shadow::FloorShadow,
    lifted: near_plane::NearPlaneClipping,
    impostors: impostors::Impostors,
    tree_shadow: tree_shadow::TreeShadow,
    frame_time: frame_time::FrameTime,
}

/// Measures, prints and checks the controls.
///
/// # Errors
/// There is no GPU, it failed, a control holds, or a result cannot be written.
pub fn run(options: &Options, outputs: &Outputs) -> Result<()> {
    let land = Land::new(WORLD_SEED);
    let mut views = views::Views::open(land, options.poses)?;
    note("light across borders");
    let borders = borders::measure(&mut views)?;
    note("shading and tolerance");
    let tolerance = tolerance::measure(&mut views)?;
    note("light in shadow");
    let shadow = shadow::measure(&mut views)?;
    note("power spectrum of the ground");
    let spectrum = spectrum::measure(&mut views, &land, options.poses.div_ceil(3))?;
    let (adapter, unlit) = (views.adapter(), views.non_finite_pixels);
    drop(views);
    note("shadows on floors");
    let floor = floor_shadow::measure()?;
    note("lifted eyes");
    let lifted = near_plane::measure(&land, EYES * options.poses / POSES)?;
    note("impostors");
    let impostors = impostors::measure(&land, options.poses.div_ceil(4))?;
    note("shadows of trees");
    let tree_shadow = tree_shadow::measure()?;
    note("frame times");
    let frame_time = frame_time::measure(land)?;
    let report = Report {
        adapter,
        poses: options.poses,
        borders,
        tolerance,
        shadow,
        spectrum,
        unlit,
        floor,
        lifted,
        impostors,
        tree_shadow,
        frame_time,
    };
    publish(&report, bars::rows, bars::notes, "/adapter", outputs)?;
    ensure!(
        report.borders.planted.ratio > report.borders.land.ratio,
        "borders of chunks do not show where one side is brighter"
    );
    ensure!(report.tolerance.mesh > report.tolerance.land, "light of drawn triangles ignores the tolerance");
    ensure!(report.floor.control > report.floor.wrong, "shadows moved by 0.3 m are not seen");
    ensure!(report.lifted.magenta_control > 0, "no near plane cuts the land by the vertical rule");
    ensure!(
        report.impostors.without > report.impostors.flip,
        "impostors are no nearer to trees than no trees"
    );
    Ok(())
}
