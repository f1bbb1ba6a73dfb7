//! How much shading changes when the tolerance grows: mean FLIP of the ground between pictures of
//! 0.5 and 4 px.

use super::views::{SIZE, Shot, Views, is_one_surface};
use crate::flip::{self, PIXELS_PER_DEGREE};
use client::gpu::GpuError;
use client::settings::{Normals, Show};
use serde::Serialize;

/// The tolerances, pixels.
const TOLERANCES_PX: [f64; 2] = [0.5, 4.0];

/// Pixels that a surface may move by and still counts as in its place.
const STILL: f32 = 0.25;

/// Mean FLIP over the ground of all poses.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Tolerance {
    /// Normals of the land.
    pub land: f64,
    /// Normals of the drawn triangles: the control.
    pub mesh: f64,
    /// Normals of the land, light on white ground: without the materials, which move with the
    /// drawn surface.
    pub land_light: f64,
    /// The same by normals of the drawn triangles.
    pub mesh_light: f64,
    /// The lit picture where the drawn surface stays in place, to a quarter of a pixel: what is
    /// left there is no movement of the materials with the surface.
    pub still: f64,
    /// The same by normals of the drawn triangles.
    pub mesh_still: f64,
}

/// Measures all poses.
pub fn measure(views: &mut Views) -> Result<Tolerance, GpuError> {
    let shot = |normals, show| Shot { normals, show, ..Shot::IMAGE };
    let (land, still) = change(views, shot(Normals::Land, Show::Image))?;
    let (mesh, mesh_still) = change(views, shot(Normals::Mesh, Show::Image))?;
    let (land_light, _) = change(views, shot(Normals::Land, Show::Light))?;
    let (mesh_light, _) = change(views, shot(Normals::Mesh, Show::Light))?;
    Ok(Tolerance { land, mesh, land_light, mesh_light, still, mesh_still })
}

/// Mean FLIP of the ground, and of the part of it that stays in place.
fn change(views: &mut Views, shot: Shot) -> Result<(f64, f64), GpuError> {
    let (mut all, mut still) = ((0.0, 0_usize), (0.0, 0_usize));
    for case in views.cases.clone() {
        let shots = TOLERANCES_PX.map(|tolerance_px| Shot { tolerance_px, ..shot });
        // Pixels whose surface stays: outlines change with the triangles, not with the shading.
        let mut grounds = Vec::new();
        let mut pictures = Vec::new();
        for shot in shots {
            grounds.push(views.light(&case, Shot { show: Show::Chunks, ..shot })?);
            pictures.push(views.image(&case, shot)?);
        }
        let map = flip::map(&pictures[0], &pictures[1], PIXELS_PER_DEGREE);
        for (pixel, flip) in map.into_iter().enumerate() {
            let [fine, coarse] = [0, 1].map(|index: usize| -grounds[index][pixel][3]);
            if !is_one_surface(fine, coarse) {
                continue;
            }
            all = (all.0 + flip, all.1 + 1);
            // A row below is a pixel away.
            let below = grounds[0].get(pixel + SIZE.0 as usize).map_or(0.0, |ground| -ground[3]);
            if below > 0.0 && (fine - coarse).abs() < STILL * (fine - below).abs() {
                still = (still.0 + flip, still.1 + 1);
            }
        }
    }
    let mean = |(sum, pixels): (f64, usize)| sum / pixels as f64;
    Ok((mean(all), mean(still)))
}
