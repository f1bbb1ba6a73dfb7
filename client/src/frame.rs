//! From a pose and a selection to what the GPU is told: uniforms, instances in drawing order,
//! counts.

use crate::camera::{Eye, Lens, Pose};
use crate::looks::{Looks, Show};
use crate::plants::PlantFrame;
use crate::render::scenes::relief::objects;
use crate::scene::Scene;
use crate::shadow::{Candidate, Page};
use crate::world::{Drawn, Resident, Selection, World};
use bytemuck::Zeroable as _;
use glam::{DVec3, Vec3};
use protocol::limits::MAX_VIEWPORT;
use protocol::view::View;
use shaders::layout::{Air, Frame, PATTERN_PERIOD_M, Relief, TerrainInstance};
use terrain::ChunkKey;
use terrain::constants::{CELLS, UNITS_PER_METRE};
use terrain::lod::{MAX_VIEW_DISTANCE_M, Viewer};

/// Triangles of one instance, a quarter of a chunk or all of a halved one.
pub const TRIANGLES_PER_INSTANCE: u64 = (CELLS * CELLS / 2) as u64;

/// Share of the tolerance that server and viewer judge chunks by. The rest is kept for the row of
/// cells beside a coarser chunk, where a part of its error adds to the chunk's own: at most 0.051
/// tolerances in all that was looked at, measured and not proved.
const JUDGED: f64 = 15.0 / 16.0;

/// The quarters of a chunk: 0 or 1 east, 0 or 1 south. The first one alone stands for all of a
/// halved chunk.
const QUARTERS: [(i32, i32); 4] = [(0, 0), (1, 0), (0, 1), (1, 1)];

/// One picture, ready to draw.
#[derive(Clone, Debug)]
pub struct FrameData {
    /// The uniforms of all passes.
    pub uniforms: Frame,
    /// The eye, for what is placed relative to it.
    pub eye: Eye,
    /// The quarters of chunks in sight, and halved chunks, nearest chunks first, so that hidden
    /// land behind near hills costs no shading.
    pub instances: Vec<TerrainInstance>,
    /// Chunks of which any quarter is in sight.
    pub chunks: usize,
    /// All chosen chunks, in sight or not, nearest first: what casts shadows on what is seen.
    pub candidates: Vec<Candidate>,
    /// What is drawn where no land is.
    pub backdrop: Backdrop,
    /// What grows on the land, if anything does.
    pub plants: Option<PlantFrame>,
    /// How often materials repeat on the objects of a scene of reliefs, along u and v, over the
    /// scene's own.
    pub relief_tiling: [f32; 2],
}

/// What is drawn where no land is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Backdrop {
    /// Sky, and the sea over land and all.
    #[default]
    SkyAndSea,
    /// Only the sky: the sea would cover what an inspecting view shows.
    Sky,
    /// Linear light of one colour, through which a gap in the land shows.
    Plain([f64; 3]),
}

/// How the picture is to be taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shot {
    /// Eye and gaze.
    pub pose: Pose,
    /// Field of view and size.
    pub lens: Lens,
    /// View distance, metres.
    pub view_distance_m: u32,
    /// Tolerated screen error, pixels.
    pub tolerance_px: f64,
    /// Seconds of the moving parts (waves, clouds).
    pub time_s: f32,
    /// Knobs of the picture.
    pub looks: Looks,
}

impl Shot {
    /// What is said to the server. Rounded to the protocol's integers.
    #[must_use]
    pub fn view(&self, id: u32) -> View {
        let mdeg = |degrees: f64| (degrees * 1000.0).round() as i32;
        let pose = self.pose.clamped();
        View {
            id,
            eye: pose.eye().units,
            velocity: [0; 3],
            yaw_mdeg: mdeg(pose.yaw_deg),
            pitch_mdeg: mdeg(pose.pitch_deg),
            fov_mdeg: mdeg(self.lens.fov_deg).clamp(1_000, 170_000) as u32,
            viewport: [self.lens.width, self.lens.height]
                .map(|side| side.clamp(1, MAX_VIEWPORT.into()) as u16),
            tolerance_q4: (self.tolerance_px * 16.0 * JUDGED).floor().clamp(1.0, 65_535.0) as u16,
            distance_m: self.view_distance_m.min(MAX_VIEW_DISTANCE_M),
        }
    }

    /// The part that decides which chunks are wanted, by the very integers that the server is told.
    #[must_use]
    pub fn viewer(&self) -> Viewer {
        self.view(0).viewer()
    }

    /// Puts a frame together from what was selected.
    #[must_use]
    pub fn frame(&self, scene: Scene, world: &World, selection: &Selection) -> FrameData {
        let eye = self.pose.eye();
        let sight = Sight::new(self);
        let mut nearest_first: Vec<&Drawn> = selection.drawn.iter().collect();
        nearest_first.sort_by_cached_key(|drawn| (nearness(&eye, drawn.key), drawn.key));
        let (mut instances, mut candidates, mut chunks) = (Vec::new(), Vec::new(), 0);
        for drawn in nearest_first {
            let Some(chunk) = world.get(drawn.key) else { continue };
            let parent = drawn.key.parent().and_then(|parent| world.get(parent)).unwrap_or(chunk);
            let before = instances.len();
            let whole = sight.may_show(&eye, drawn.key.origin(), drawn.key.side(), chunk, parent);
            let parts = if drawn.seams.is_halved { &QUARTERS[..1] } else { &QUARTERS };
            for quarter in parts.iter().copied().filter(|_| whole) {
                let (corner, side) = quarter_of(drawn.key, quarter);
                if drawn.seams.is_halved || sight.may_show(&eye, corner, side, chunk, parent) {
                    instances.push(instance(&eye, drawn, quarter, chunk, parent));
                }
            }
            let in_sight = instances.len() > before;
            chunks += usize::from(in_sight);
            let page = Page { key: drawn.key, slot: chunk.slot, top: chunk.max };
            candidates.push(Candidate { page, in_sight });
        }
        FrameData {
            uniforms: self.uniforms(scene, &eye),
            eye,
            instances,
            chunks,
            candidates,
            backdrop: match self.looks.show {
                Show::Picture => Backdrop::SkyAndSea,
                _ => Backdrop::Sky,
            },
            plants: self.plants(world, &selection.drawn),
            relief_tiling: self.looks.relief.sane().tiling,
        }
    }

    /// The knobs of reliefs for the shaders. The reliefs of a small scene sink all together, so
    /// that what is marched and what is displaced stay alike; those of the land sink one by one.
    fn relief(&self, scene: Scene) -> Relief {
        let knobs = self.looks.relief;
        let relief = knobs.layout();
        let Some(relief_m) = objects::tallest_m(scene) else { return relief };
        let pixels_per_radian = f64::from(self.lens.height) / (2.0 * self.lens.half_height());
        let distance_m = self.pose.position_m.length().max(0.01);
        let height_px = f64::from(relief_m * relief.amplitude) * pixels_per_radian / distance_m;
        Relief { amplitude: relief.amplitude * knobs.left(height_px as f32), ..relief }
    }

    fn uniforms(&self, scene: Scene, eye: &Eye) -> Frame {
        let (pose, lens) = (&self.pose, &self.lens);
        let half_height = lens.half_height();
        let height_m = metres(f64::from(eye.units[1])) as f32 + eye.fraction_m.y;
        let wrapped = |units: i32, fraction: f32| {
            let period = PATTERN_PERIOD_M * UNITS_PER_METRE;
            metres(f64::from(units & (period - 1))) as f32 + fraction
        };
        let (light, looks) = (scene.light().under(&self.looks), &self.looks);
        let waves = looks.waves.sane();
        Frame {
            clip_from_camera: lens.clip_from_camera(pose).to_cols_array_2d(),
            ray_right: (pose.right() * half_height * lens.aspect()).as_vec3().into(),
            time_s: self.time_s,
            ray_up: (pose.up() * half_height).as_vec3().into(),
            eye_height_m: height_m,
            ray_forward: pose.forward().as_vec3().into(),
            view_distance_m: self.view_distance_m as f32,
            sun: light.sun.into(),
            exposure: light.exposure,
            eye_fraction_m: eye.fraction_m.into(),
            pixel: 1.0 / lens.height as f32,
            pattern_eye_m: [wrapped(eye.units[0], eye.fraction_m.x), wrapped(eye.units[2], eye.fraction_m.z)],
            viewport: [lens.width as f32, lens.height as f32],
            diffuse: looks.diffuse as u32,
            visibility: looks.visibility as u32,
            tiling: looks.tiling as u32,
            water_tier: looks.water as u32,
            shadows: looks.shadows as u32,
            show: looks.show as u32,
            pixels_per_radian: (f64::from(lens.height) / (2.0 * half_height)) as f32,
            tolerance_px: self.tolerance_px as f32,
            parallax_factor: waves.parallax_factor,
            parallax_bias_m: waves.parallax_bias_m,
            wave_steepness: waves.steepness,
            reserved: 0.0,
            relief: self.relief(scene),
            air: Air::zeroed(),
        }
    }
}

fn metres(units: f64) -> f64 {
    units / f64::from(UNITS_PER_METRE)
}

/// Squared horizontal distance from the eye to the middle of a chunk, square metres: an order, not
/// a measure.
fn nearness(eye: &Eye, key: ChunkKey) -> i64 {
    let (x, z) = key.origin();
    let half = i64::from(key.side() / 2);
    let axis = |low: i32, eye: i32| (i64::from(low) + half - i64::from(eye)) / i64::from(UNITS_PER_METRE);
    axis(x, eye.units[0]).pow(2) + axis(z, eye.units[2]).pow(2)
}

/// Low corner and side of a quarter of a chunk, units.
fn quarter_of(key: ChunkKey, (east, south): (i32, i32)) -> ((i32, i32), u32) {
    let side = key.side() / 2;
    let (x, z) = key.origin();
    // Halves of chunks inside the world; only the root's side does not fit a signed number, and its
    // half does.
    ((x + east * side as i32, z + south * side as i32), side)
}

fn instance(
    eye: &Eye,
    drawn: &Drawn,
    quarter: (i32, i32),
    chunk: &Resident,
    parent: &Resident,
) -> TerrainInstance {
    let key = drawn.key;
    let (x, z) = key.origin();
    let (east, south) = key.quarter();
    let [edges, corners, inside] = TerrainInstance::seam_words(&drawn.seams);
    // Integers first, so that the distance to a near chunk is exact however far both are from the
    // origin.
    let relative = |low: i32, eye: i32| metres((i64::from(low) - i64::from(eye)) as f64) as f32;
    let period = PATTERN_PERIOD_M * UNITS_PER_METRE;
    TerrainInstance {
        origin_m: [relative(x, eye.units[0]), relative(0, eye.units[1]), relative(z, eye.units[2])],
        spacing_m: metres(f64::from(key.spacing())) as f32,
        pattern_m: [x, z].map(|low| metres(f64::from(low & (period - 1))) as f32),
        error_m: metres(f64::from(chunk.error)) as f32,
        parent_error_m: metres(f64::from(parent.error)) as f32,
        slot: chunk.slot,
        parent_slot: parent.slot,
        edges,
        corners,
        inside,
        place: u32::from(key.level())
            | ((east as u32) << 8)
            | ((south as u32) << 9)
            | ((quarter.0 as u32) << 10)
            | ((quarter.1 as u32) << 11),
    }
}

/// The four side planes of the view, through the eye.
struct Sight {
    /// Inward normals, axes of the world.
    normals: [DVec3; 4],
}

impl Sight {
    fn new(shot: &Shot) -> Self {
        let (forward, right, up) = (shot.pose.forward(), shot.pose.right(), shot.pose.up());
        let height = shot.lens.half_height();
        let width = height * shot.lens.aspect();
        Self {
            normals: [
                right + forward * width,
                forward * width - right,
                up + forward * height,
                forward * height - up,
            ],
        }
    }

    /// Whether any of the box over a square of a chunk may lie inside all four planes. Errs on the
    /// side of drawing.
    ///
    /// The box holds the parent's extremes too: a morphed vertex lies between the two surfaces.
    fn may_show(
        &self,
        eye: &Eye,
        (x, z): (i32, i32),
        side: u32,
        chunk: &Resident,
        parent: &Resident,
    ) -> bool {
        let side = i64::from(side);
        let low = [i64::from(x), i64::from(chunk.min.min(parent.min)), i64::from(z)];
        let high = [i64::from(x) + side, i64::from(chunk.max.max(parent.max)), i64::from(z) + side];
        let relative = |corner: [i64; 3]| {
            // One unit of slack covers the eye's fraction.
            DVec3::from_array([0, 1, 2].map(|axis| (corner[axis] - i64::from(eye.units[axis])) as f64))
        };
        let (low, high) = (relative(low) - DVec3::ONE, relative(high) + DVec3::ONE);
        self.normals.iter().all(|normal| {
            let farthest = DVec3::select(normal.cmpgt(DVec3::ZERO), high, low);
            normal.dot(farthest) >= 0.0
        })
    }
}

/// Direction and strength of a scene's light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Unit vector to the sun.
    pub sun: Vec3,
    /// Multiplies all light before the tone curve.
    pub exposure: f32,
}

impl Light {
    /// The light with what the knobs change about it. A place of the sun that is not a number
    /// leaves the sun where it is, an exposure that is none changes nothing; both are cut to their
    /// ranges.
    #[must_use]
    pub fn under(self, looks: &Looks) -> Self {
        let asked =
            looks.sun.filter(|place| place.azimuth_deg.is_finite() && place.elevation_deg.is_finite());
        let sun = asked.map_or(self.sun, |place| {
            let azimuth = place.azimuth_deg.to_radians();
            let elevation = place.elevation_deg.clamp(-90.0, 90.0).to_radians();
            Vec3::new(azimuth.sin() * elevation.cos(), elevation.sin(), -azimuth.cos() * elevation.cos())
        });
        let ev = if looks.exposure_ev.is_finite() { looks.exposure_ev.clamp(-8.0, 8.0) } else { 0.0 };
        // Inspecting views have colours of their own, not light.
        let adapted_ev = if looks.show == Show::Picture { adaptation_ev(sun.y) } else { 0.0 };
        Self { sun, exposure: self.exposure * (ev + adapted_ev).exp2() }
    }
}

/// Stops by which the eye opens when the sun sinks to the sine `rise` above the horizon: from none
/// at 12 degrees up to 3.5 at 12 degrees below, where the light has fallen by more than ten. Nights
/// stay dark.
fn adaptation_ev(rise: f32) -> f32 {
    let dusk = ((0.2 - rise) / 0.4).clamp(0.0, 1.0);
    3.5 * dusk * dusk * (3.0 - 2.0 * dusk)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::looks::SunPlace;
    use crate::world::select;
    use std::collections::HashSet;
    use terrain::{Land, lod};

    fn shot(camera: &str) -> Shot {
        Shot {
            pose: camera.parse().unwrap(),
            lens: Lens { fov_deg: 60.0, width: 640, height: 360 },
            view_distance_m: 2000,
            tolerance_px: 4.0,
            time_s: 0.0,
            looks: Looks::default(),
        }
    }

    fn filled(shot: &Shot) -> World {
        let land = Land::new(1);
        let mut world = World::new(5000);
        for needed in lod::select(&land, &shot.viewer(), usize::MAX) {
            world.insert(land.chunk(needed.key));
        }
        world
    }

    #[test]
    fn instances_are_exact_and_come_nearest_first() {
        let shot = shot("100.123,200,-300,0,-20");
        let mut world = filled(&shot);
        let selection = select(&mut world, &shot.viewer());
        let frame = shot.frame(Scene::Island, &world, &selection);
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
    fn a_chunk_in_the_picture_is_never_left_out() {
        for camera in ["0,150,0,0,0", "0,150,0,77,-60", "-900,400,350,200,-10", "50,30,50,300,40"] {
            let shot = shot(camera);
            let mut world = filled(&shot);
            let selection = select(&mut world, &shot.viewer());
            let frame = shot.frame(Scene::Island, &world, &selection);
            let quarters = |instance: &TerrainInstance| {
                let is_halved = instance.inside & TerrainInstance::HALVED != 0;
                let first = instance.place >> 10;
                (if is_halved { 0..4 } else { first..first + 1 })
                    .map(|quarter| (instance.slot, quarter))
                    .collect()
            };
            let shown: HashSet<(u32, u32)> =
                frame.instances.iter().flat_map(|instance| -> Vec<_> { quarters(instance) }).collect();
            let clip_from_camera = shot.lens.clip_from_camera(&shot.pose);
            let eye = shot.pose.position_m;
            for key in selection.drawn.iter().map(|drawn| drawn.key) {
                let chunk = world.get(key).unwrap();
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

    #[test]
    fn the_eye_opens_at_dusk_only_and_odd_options_change_nothing() {
        let scene = Scene::Island.light();
        let under = |elevation_deg, exposure_ev| {
            let sun = Some(SunPlace { azimuth_deg: 10.0, elevation_deg });
            scene.under(&Looks { sun, exposure_ev, ..Looks::default() })
        };
        let exposures = [90.0, 45.0, 12.0, 5.0, 0.0, -6.0, -12.0, -90.0].map(|deg| under(deg, 0.0).exposure);
        assert!(exposures.is_sorted() && exposures[1] == scene.exposure, "{exposures:?}");
        assert!((exposures[7] / exposures[0]).log2() < 4.0, "nights stay dark: {exposures:?}");
        let levels = Looks { show: Show::Levels, sun: under_horizon(), ..Looks::default() };
        assert_eq!(scene.under(&levels).exposure, scene.exposure);

        assert_eq!(under(200.0, 0.0).sun, under(90.0, 0.0).sun);
        assert_eq!(under(45.0, 100.0).exposure, under(45.0, 8.0).exposure);
        for odd in [f32::NAN, f32::INFINITY] {
            assert_eq!(under(odd, odd), scene);
        }
        assert_ne!(under(45.0, 1.0), scene);
    }

    fn under_horizon() -> Option<SunPlace> {
        Some(SunPlace { azimuth_deg: 0.0, elevation_deg: -20.0 })
    }

    #[test]
    fn the_tolerance_is_in_sixteenths_of_a_pixel_a_part_is_kept_and_it_is_never_zero() {
        let tolerance = |tolerance_px| Shot { tolerance_px, ..shot("0,0,0,0,0") }.viewer().tolerance_q4;
        assert_eq!((tolerance(2.0), tolerance(1.0), tolerance(0.0), tolerance(0.06)), (30, 15, 1, 1));
        assert_eq!(shot("0,0,0,0,0").viewer().pixels_per_radian, 312);
    }
}
