//! How much shading changes when the tolerance grows: mean FLIP of the ground between pictures of
//! 0.5 and 4 px.

use super::views::{DrawOptions, SIZE, Views, is_one_surface};
use crate::flip::{self, PIXELS_PER_DEGREE};
use crate::lod::screen::ViewCase;
use client::gpu::{GpuError, Image};
use client::settings::{Normals, Show};
use serde::Serialize;

/// The tolerances, pixels.
const TOLERANCES_PX: [f64; 2] = [0.5, 4.0];

/// Pixels that a surface may move by and still counts as in its place.
const STILL: f32 = 0.25;

/// The pictures that are compared: normals and the view.
const KINDS: [(Normals, Show); 4] = [
    (Normals::Land, Show::Image),
    (Normals::Mesh, Show::Image),
    (Normals::Land, Show::Light),
    (Normals::Mesh, Show::Light),
];

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
    let mut changes = [Change::default(); KINDS.len()];
    for case in views.cases.clone() {
        let [fine, coarse] = TOLERANCES_PX.map(|tolerance_px| PosePictures::new(views, &case, tolerance_px));
        let (fine, coarse) = (fine?, coarse?);
        for ((change, fine_picture), coarse_picture) in
            changes.iter_mut().zip(&fine.pictures).zip(&coarse.pictures)
        {
            let map = flip::map(fine_picture, coarse_picture, PIXELS_PER_DEGREE);
            change.add(&map, &fine.ground, &coarse.ground);
        }
    }
    let [land, mesh, land_light, mesh_light] = changes.map(|change| mean(change.all));
    let [still, mesh_still, ..] = changes.map(|change| mean(change.still));
    Ok(Tolerance { land, mesh, land_light, mesh_light, still, mesh_still })
}

/// A pose with one tolerance.
struct PosePictures {
    /// The fourth channel is minus the distance of land.
    ground: Vec<[f32; 4]>,
    /// As [`KINDS`].
    pictures: Vec<Image>,
}

impl PosePictures {
    fn new(views: &mut Views, case: &ViewCase, tolerance_px: f64) -> Result<Self, GpuError> {
        let options = DrawOptions { tolerance_px, ..DrawOptions::IMAGE };
        let ground = views.light(case, DrawOptions { show: Show::Chunks, ..options })?;
        let picture = |(normals, show)| views.image(case, DrawOptions { normals, show, ..options });
        Ok(Self { ground, pictures: KINDS.into_iter().map(picture).collect::<Result<_, _>>()? })
    }
}

/// Sum and number of pixels of FLIP.
type Sum = (f64, usize);

/// FLIP of the ground, and of the part of it that stays in place.
#[derive(Clone, Copy, Default)]
struct Change {
    all: Sum,
    still: Sum,
}

impl Change {
    fn add(&mut self, map: &[f64], fine: &[[f32; 4]], coarse: &[[f32; 4]]) {
        for (pixel, flip) in map.iter().enumerate() {
            let [fine_m, coarse_m] = [fine, coarse].map(|ground| -ground[pixel][3]);
            // Outlines change with the triangles, not with the shading.
            if !is_one_surface(fine_m, coarse_m) {
                continue;
            }
            self.all = (self.all.0 + flip, self.all.1 + 1);
            // A row below is a pixel away.
            let below_m = fine.get(pixel + SIZE.0 as usize).map_or(0.0, |ground| -ground[3]);
            if below_m > 0.0 && (fine_m - coarse_m).abs() < STILL * (fine_m - below_m).abs() {
                self.still = (self.still.0 + flip, self.still.1 + 1);
            }
        }
    }
}

fn mean((sum, pixels): Sum) -> f64 {
    sum / pixels as f64
}
