//! GPU input of one frame, from view parameters and a chunk selection: uniforms, instances in
//! drawing order, counts.

use crate::cache::{ChunkCache, vertical_scale};
use crate::camera::Eye;
use crate::features::post::PostFrame;
use crate::features::terrain::instance::{metres, terrain_instance};
use crate::features::terrain_clipmap::ClipmapLand;
use crate::features::terrain_shadow::{Candidate, Page};
use crate::features::vegetation::VegetationFrame;
use crate::frustum::Frustum;
use crate::lighting::exposure_ev;
use crate::lod::{Drawn, Selection};
use crate::scene::{Scene, objects};
use crate::settings::{Normals, Show};
use crate::view::ViewParams;
use bytemuck::Zeroable as _;
use shaders::layout::{Atmosphere, Frame, PATTERN_PERIOD_M, PomParams, TerrainInstance};
use terrain::ChunkKey;
use terrain::constants::{CELLS, UNITS_PER_METRE};

/// Triangles of one instance: a quarter of a chunk, or all of a decimated one.
pub const TRIANGLES_PER_INSTANCE: u64 = (CELLS * CELLS / 2) as u64;

/// The quarters of a chunk: 0 or 1 east, 0 or 1 south. The first one stands for all of a decimated
/// chunk.
const QUARTERS: [(i32, i32); 4] = [(0, 0), (1, 0), (0, 1), (1, 1)];

/// One frame, ready to draw.
#[derive(Clone, Debug)]
pub struct FrameData {
    /// Uniforms of all passes.
    pub uniforms: Frame,
    /// The eye, for objects placed relative to it.
    pub eye: Eye,
    /// Visible quarters of chunks, and visible decimated chunks; nearest chunks first, so that
    /// early depth tests reject hidden land.
    pub instances: Vec<TerrainInstance>,
    /// Chunks with a visible quarter.
    pub chunks: usize,
    /// All selected chunks, visible or not, nearest first: the shadow casters.
    pub candidates: Vec<Candidate>,
    /// Background.
    pub background: Background,
    /// Input of the terrain clipmap; none if light follows the drawn triangles.
    pub clipmap: Option<ClipmapLand>,
    /// Vegetation, if there is any.
    pub plants: Option<VegetationFrame>,
    /// From the HDR target to the image.
    pub post: PostFrame,
    /// Material repeats on the objects of a parallax scene along u and v, relative to the scene's
    /// own.
    pub pom_tiling: [f32; 2],
}

/// Background.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Background {
    /// Sky and sea.
    #[default]
    SkyAndSea,
    /// Sky only: the sea would cover what a debug view shows.
    Sky,
    /// Linear light of one colour, to find cracks in the land.
    Plain([f64; 3]),
}

impl ViewParams {
    /// The frame of a selection. Every number of it is finite: invalid parameters are replaced
    /// ([`ViewParams::sanitized`]).
    #[must_use]
    pub fn frame(&self, scene: Scene, cache: &ChunkCache, selection: &Selection) -> FrameData {
        self.sanitized().frame_of_valid(scene, cache, selection)
    }

    fn frame_of_valid(&self, scene: Scene, cache: &ChunkCache, selection: &Selection) -> FrameData {
        let eye = self.pose.eye();
        let frustum = Frustum::new(&self.pose, &self.rendered());
        let mut nearest_first: Vec<&Drawn> = selection.drawn.iter().collect();
        nearest_first.sort_by_cached_key(|drawn| (distance_squared(&eye, drawn.key), drawn.key));
        let (mut instances, mut candidates, mut chunks) = (Vec::new(), Vec::new(), 0);
        for drawn in nearest_first {
            let Some(chunk) = cache.get(drawn.key) else { continue };
            let parent = drawn.key.parent().and_then(|parent| cache.get(parent)).unwrap_or(chunk);
            let before = instances.len();
            let whole = frustum.may_intersect(&eye, drawn.key.origin(), drawn.key.side(), chunk, parent);
            let parts = if drawn.seams.is_decimated { &QUARTERS[..1] } else { &QUARTERS };
            for quarter in parts.iter().copied().filter(|_| whole) {
                let (corner, side) = quarter_of(drawn.key, quarter);
                if drawn.seams.is_decimated || frustum.may_intersect(&eye, corner, side, chunk, parent) {
                    instances.push(terrain_instance(&eye, drawn, quarter, chunk, parent));
                }
            }
            let is_visible = instances.len() > before;
            chunks += usize::from(is_visible);
            let page = Page { key: drawn.key, slot: chunk.slot, max_height: chunk.max };
            candidates.push(Candidate { page, is_visible });
        }
        let uniforms = self.uniforms(scene, &eye);
        // Debug views and an eye under water show no plants.
        let has_plants = self.settings.show == Show::Image && uniforms.eye_height_m > 0.0;
        FrameData {
            uniforms,
            eye,
            instances,
            chunks,
            candidates,
            background: match self.settings.show {
                Show::Image => Background::SkyAndSea,
                _ => Background::Sky,
            },
            clipmap: self.clipmap_land(cache),
            plants: has_plants.then(|| self.plants(cache, &selection.drawn)).flatten(),
            post: PostFrame::new(
                self.settings.post,
                exposure_ev(&self.settings),
                self.settings.show == Show::Image,
            ),
            pom_tiling: self.settings.pom.sanitized().tiling,
        }
    }

    /// The land of the terrain clipmap, if the settings ask for it and the land is known.
    fn clipmap_land(&self, cache: &ChunkCache) -> Option<ClipmapLand> {
        let (land, digest) = cache.verified_land()?;
        let scale = cache.vertical_scale() as f32 / vertical_scale::ONE as f32;
        (self.settings.normals == Normals::Land).then_some(ClipmapLand {
            land,
            digest,
            vertical_scale: scale,
        })
    }

    /// The vegetation of a frame over the drawn chunks, if there is any.
    #[must_use]
    pub fn plants(&self, cache: &ChunkCache, drawn: &[Drawn]) -> Option<VegetationFrame> {
        let settings = self.settings.plants.sanitized();
        VegetationFrame::new(&self.pose, &self.rendered(), self.view_distance_m, settings, cache, drawn)
    }

    /// Parallax settings for the shaders. All objects of a small scene fade together, so that
    /// marched and displaced ones stay comparable; on the land each material fades by itself.
    fn pom(&self, scene: Scene) -> PomParams {
        let settings = self.settings.pom;
        let pom = settings.layout();
        let Some(relief_m) = objects::tallest_relief_m(scene) else { return pom };
        let projection = self.rendered();
        let pixels_per_radian = f64::from(projection.height) / (2.0 * projection.half_height());
        let distance_m = self.pose.position_m.length().max(0.01);
        let height_px = f64::from(relief_m * pom.amplitude) * pixels_per_radian / distance_m;
        PomParams { amplitude: pom.amplitude * settings.fade(height_px as f32), ..pom }
    }

    fn uniforms(&self, scene: Scene, eye: &Eye) -> Frame {
        let (pose, projection) = (&self.pose, &self.rendered());
        let half_height = projection.half_height();
        let height_m = metres(f64::from(eye.units[1])) as f32 + eye.fraction_m.y;
        let wrapped = |units: i32, fraction: f32| {
            let period = PATTERN_PERIOD_M * UNITS_PER_METRE;
            metres(f64::from(units & (period - 1))) as f32 + fraction
        };
        let (light, settings) = (scene.light().with_settings(&self.settings), &self.settings);
        let waves = settings.waves.sanitized();
        Frame {
            clip_from_camera: projection.clip_from_camera(pose).to_cols_array_2d(),
            ray_right: (pose.right() * half_height * projection.aspect()).as_vec3().into(),
            time_s: self.time_s,
            ray_up: (pose.up() * half_height).as_vec3().into(),
            eye_height_m: height_m,
            ray_forward: pose.forward().as_vec3().into(),
            view_distance_m: self.view_distance_m as f32,
            sun: light.sun.into(),
            exposure: light.exposure,
            eye_fraction_m: eye.fraction_m.into(),
            pixel: 1.0 / projection.height as f32,
            pattern_eye_m: [wrapped(eye.units[0], eye.fraction_m.x), wrapped(eye.units[2], eye.fraction_m.z)],
            viewport: [projection.width as f32, projection.height as f32],
            diffuse: settings.diffuse as u32,
            visibility: settings.visibility as u32,
            tiling: settings.tiling as u32,
            water_tier: settings.water as u32,
            shadows: settings.shadows as u32,
            show: settings.show as u32,
            pixels_per_radian: (f64::from(projection.height) / (2.0 * half_height)) as f32,
            tolerance_px: self.tolerance_px as f32,
            parallax_factor: waves.parallax_factor,
            parallax_bias_m: waves.parallax_bias_m,
            wave_steepness: waves.steepness,
            grass: settings.plants.sanitized().packed_grass(self.view_distance_m),
            pom: self.pom(scene),
            atmosphere: Atmosphere::zeroed(),
        }
    }
}

/// Squared horizontal distance from the eye to the middle of a chunk, whole square metres: a sort
/// key.
fn distance_squared(eye: &Eye, key: ChunkKey) -> i64 {
    let (x, z) = key.origin();
    let half = i64::from(key.side() / 2);
    let axis = |low: i32, eye: i32| (i64::from(low) + half - i64::from(eye)) / i64::from(UNITS_PER_METRE);
    axis(x, eye.units[0]).pow(2) + axis(z, eye.units[2]).pow(2)
}

/// Low corner and side of a quarter of a chunk, units.
fn quarter_of(key: ChunkKey, (east, south): (i32, i32)) -> ((i32, i32), u32) {
    let side = key.side() / 2;
    let (x, z) = key.origin();
    // Cannot overflow: half of any chunk's side fits a signed number, the root's included.
    ((x + east * side as i32, z + south * side as i32), side)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Projection;
    use crate::lod::select;
    use crate::settings::RenderSettings;
    use glam::DVec3;
    use shaders::layout::ChunkWords;
    use std::collections::HashSet;
    use terrain::{Land, lod};

    fn view(camera: &str) -> ViewParams {
        ViewParams {
            pose: camera.parse().unwrap(),
            projection: Projection { fov_deg: 60.0, width: 640, height: 360 },
            view_distance_m: 2000,
            tolerance_px: 4.0,
            time_s: 0.0,
            settings: RenderSettings::default(),
        }
    }

    fn filled(view: &ViewParams) -> ChunkCache {
        let land = Land::new(1);
        let mut cache = ChunkCache::new(5000);
        for needed in lod::select(&land, &view.viewer(), usize::MAX) {
            cache.insert(land.chunk(needed.key));
        }
        cache
    }

    #[test]
    fn instances_are_exact_and_come_nearest_first() {
        let view = view("100.123,200,-300,0,-20");
        let mut cache = filled(&view);
        let selection = select(&mut cache, &view.viewer());
        let frame = view.frame(Scene::Island, &cache, &selection);
        assert!(
            frame.chunks > 0
                && frame.chunks < selection.drawn.len()
                && frame.instances.len() < 4 * frame.chunks,
            "some are behind"
        );
        let distance = |instance: &TerrainInstance| {
            let half = instance.spacing_m * 32.0;
            // Quarters share their chunk's corner.
            (instance.origin_m[0] + half).hypot(instance.origin_m[2] + half)
        };
        assert!(frame.instances.is_sorted_by(|a, b| distance(a) <= distance(b) + 2.0));
        for instance in &frame.instances {
            // Whole units only: the fraction of the eye is subtracted in the shader, after exact
            // sums.
            assert!(instance.origin_m.iter().all(|value| (value * 256.0).fract() == 0.0));
        }
    }

    #[test]
    fn no_visible_chunk_is_culled() {
        for camera in ["0,150,0,0,0", "0,150,0,77,-60", "-900,400,350,200,-10", "50,30,50,300,40"] {
            let view = view(camera);
            let mut cache = filled(&view);
            let selection = select(&mut cache, &view.viewer());
            let frame = view.frame(Scene::Island, &cache, &selection);
            let quarters = |instance: &TerrainInstance| {
                let is_decimated_chunk = instance.words.inside & ChunkWords::DECIMATED != 0;
                let first = instance.words.place >> 10;
                (if is_decimated_chunk { 0..4 } else { first..first + 1 })
                    .map(|quarter| (instance.words.slot, quarter))
                    .collect()
            };
            let shown: HashSet<(u32, u32)> =
                frame.instances.iter().flat_map(|instance| -> Vec<_> { quarters(instance) }).collect();
            let clip_from_camera = view.projection.clip_from_camera(&view.pose);
            let eye = view.pose.position_m;
            for key in selection.drawn.iter().map(|drawn| drawn.key) {
                let chunk = cache.get(key).unwrap();
                let (x, z) = key.origin();
                for index in (0..65 * 65).step_by(7) {
                    let at = |low: i32, step: i32| f64::from(low + step * key.spacing()) / 256.0;
                    let point = DVec3::new(
                        at(x, index % 65),
                        f64::from(chunk.heights[index as usize]) / 256.0,
                        at(z, index / 65),
                    );
                    let clip = clip_from_camera * (point - eye).as_vec3().extend(1.0);
                    let seen = clip.w > 0.3 && clip.x.abs() < clip.w && clip.y.abs() < clip.w;
                    let quarter = u32::from(index % 65 >= 32) + 2 * u32::from(index / 65 >= 32);
                    let is_drawn = shown.contains(&(chunk.slot, quarter));
                    assert!(
                        !seen || is_drawn,
                        "{camera}: quarter {quarter} of {key} is visible but not drawn"
                    );
                }
            }
        }
    }
}
