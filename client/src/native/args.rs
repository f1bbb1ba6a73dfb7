//! The command line. Options are a contract: scripts call them.

#[cfg(test)]
mod tests;

use super::pom_args::PomArgs;
use super::post_args::PostArgs;
use super::vegetation_args::VegetationArgs;
use super::window_test_args::WindowTestArgs;
use crate::camera::{Pose, Projection};
use crate::features::terrain_clipmap::window::STANDARD_TEXELS;
use crate::features::water::{WaterTier, WaveSettings};
use crate::native::parse::parse_within;
use crate::native::quality::{Preset, Quality};
use crate::scene::places::{self, Place};
use crate::scene::{DEFAULT_WORLD_SEED, Scene};
use crate::settings::{Diffuse, Normals, RenderSettings, Shadows, Show, SunPosition, Tiling, Visibility};
use clap::{Parser, builder::RangedU64ValueParser};
use protocol::Delivery;
use std::path::PathBuf;
use terrain::lod::MAX_VIEW_DISTANCE_M;
use terrain::{Land, WorldDigest};
use tokio_tungstenite::tungstenite::http::Uri;

/// Default address of a server.
const DEFAULT_SERVER: &str = "ws://127.0.0.1:7580/v1/stream";

/// Largest side of an image, pixels: the texture limit of portable WebGPU.
const MAX_SIDE: u32 = 8192;

/// Streams a terrain from a Tombolo server and draws it, in a window or (with --shot) into a file.
#[derive(Clone, Debug, Parser)]
#[command(name = "tombolo-view", version, about)]
pub struct Args {
    /// Stream URL of the server [default: ws://127.0.0.1:7580/v1/stream; the scenes grass and
    /// culling generate their land]
    #[arg(long, value_name = "URL", value_parser = parse_url)]
    pub connect: Option<Uri>,

    /// Seed of the land that a scene generates [default: 1]
    #[arg(long, value_name = "N", conflicts_with = "connect")]
    pub world_seed: Option<u64>,

    /// Delivery of chunks: exact (all heights), refined (all heights in fewer bytes, uses up to 17
    /// MiB of memory), seed (digests; chunks are generated here and verified) or quantised:METRES
    /// (heights with at most this error)
    #[arg(long, value_name = "exact|refined|seed|quantised:METRES", default_value_t = Delivery::Exact)]
    pub delivery: Delivery,

    /// Requires the world with this digest, 64 hexadecimal digits; servers of other worlds are
    /// rejected
    #[arg(long, value_name = "HEX", value_parser = parse_digest)]
    pub digest: Option<WorldDigest>,

    /// What to show
    #[arg(long, value_enum, default_value_t)]
    pub scene: Scene,

    /// Start position in metres (east, up, south of the origin) and direction in degrees (yaw
    /// clockwise from north, pitch upward) [default: a view of the scene]
    #[arg(long, value_name = "X,Y,Z,YAW,PITCH", allow_hyphen_values = true)]
    pub camera: Option<Pose>,

    /// Start at a place of the home island, found in the land of the world
    #[arg(long, value_enum, value_name = "NAME", conflicts_with = "camera")]
    pub place: Option<Place>,

    /// Preset of tolerance, samples, anisotropy, tiling, relief, plants, --cull, view distance,
    /// --render-scale, --bloom and --water; options that are given win
    #[arg(long, value_enum, default_value_t)]
    pub quality: Quality,

    /// Draws into this PNG file instead of a window
    #[arg(long, value_name = "FILE.png")]
    pub shot: Option<PathBuf>,

    /// Size of the image or window in pixels, each side 1 to 8192
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = parse_size)]
    pub size: (u32, u32),

    /// Frames to draw and time, then exit [default: 1 with --shot, unlimited in a window]
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub frames: Option<u32>,

    /// Writes measurements into this JSON file at the end
    #[arg(long, value_name = "FILE.json")]
    pub stats: Option<PathBuf>,

    /// View distance in metres, 100 to 65536 [default: 20000 in the scene island, 8000 with
    /// --quality low and 32000 with high; 8000 in other scenes]
    #[arg(long, value_name = "M", allow_negative_numbers = true,
          value_parser = clap::value_parser!(u32).range(100..=i64::from(MAX_VIEW_DISTANCE_M)))]
    pub view_distance: Option<u32>,

    /// Tolerated geometric error on screen in pixels, 0.0625 to 1000; less is finer [default: 2; 4
    /// with --quality low, 1 with high]
    #[arg(long, value_name = "PX", allow_negative_numbers = true,
          value_parser = |text: &str| parse_within(text, 0.0625, 1000.0))]
    pub tolerance: Option<f64>,

    /// Vertical field of view in degrees, 1 to 170
    #[arg(long, value_name = "DEG", default_value_t = 60.0, allow_negative_numbers = true,
          value_parser = |text: &str| parse_within(text, 1.0, 170.0))]
    pub fov: f64,

    /// Memory for chunks in MiB, main and GPU memory together, 8 to 256; a view that needs more is
    /// drawn coarser
    #[arg(long, value_name = "N", default_value_t = 128, allow_negative_numbers = true,
          value_parser = RangedU64ValueParser::<usize>::new().range(8..=256))]
    pub chunk_mb: usize,

    /// Samples per pixel, 1 or 4 [default: 4; 1 with --quality low, and with auto in a window on a
    /// software driver]
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = parse_samples)]
    pub samples: Option<u32>,

    /// Samples of materials along the longer axis of a pixel's footprint, 1 (none) to 16: more are
    /// sharper at flat angles [default: 8; 1 with --quality low and on a software driver]
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = clap::value_parser!(u16).range(1..=16))]
    pub anisotropy: Option<u16>,

    /// Orbits a point straight ahead, degrees a second, -90 to 90
    #[arg(long, value_name = "DEG", allow_hyphen_values = true,
          value_parser = |text: &str| parse_within(text, -90.0, 90.0))]
    pub orbit: Option<f64>,

    /// Animation time of waves, clouds and wind in the first frame, seconds, 0 to 86400
    #[arg(long, value_name = "S", default_value_t = 0.0, allow_negative_numbers = true,
          value_parser = |text: &str| parse_within(text, 0.0, 86_400.0))]
    pub time: f64,

    /// What is shown
    #[arg(long, value_enum, default_value_t)]
    pub show: Show,

    /// Sun position in degrees: azimuth clockwise from north, elevation -90 to 90 [default: that of
    /// the scene]
    #[arg(long, value_name = "AZIMUTH,ELEVATION", allow_hyphen_values = true, value_parser = parse_sun)]
    pub sun: Option<SunPosition>,

    /// Exposure in stops relative to the scene's, -8 to 8
    #[arg(long, value_name = "EV", default_value_t = 0.0, allow_hyphen_values = true,
          value_parser = |text: &str| parse_within(text, -8.0, 8.0))]
    pub exposure: f64,

    /// Shadows of the terrain on itself
    #[arg(long, value_enum, default_value_t)]
    pub shadows: Shadows,

    /// Source of the terrain's shading normals and sky visibility: the land itself, or the drawn
    /// triangles
    #[arg(long, value_enum, default_value_t)]
    pub normals: Normals,

    /// Texels along a side of each level of the map of normals, 256 to 2048; more is sharper
    #[arg(long, value_name = "N", default_value_t = STANDARD_TEXELS, allow_negative_numbers = true,
          value_parser = clap::value_parser!(u32).range(256..=2048))]
    pub clipmap: u32,

    /// Technique against visible repetition of materials [default: hex; two-scale on land with
    /// --quality low]
    #[arg(long, value_enum)]
    pub tiling: Option<Tiling>,

    /// Diffuse reflection of the ground
    #[arg(long, value_enum, default_value_t)]
    pub diffuse: Diffuse,

    /// Visibility term of the specular reflection
    #[arg(long, value_enum, default_value_t)]
    pub visibility: Visibility,

    /// Parallax method of waves [default: three; offset on land with --quality low]
    #[arg(long, value_enum)]
    pub water: Option<WaterTier>,

    /// Folder of custom materials: PNG files such as sand_albedo.png, sand_normal.png,
    /// sand_height.png, sand_roughness.png and sand_ao.png, for sand, meadow, dry_grass, thicket,
    /// cliff, scree and cobbles; a material without any file stays procedural, and a missing file
    /// of another is named and replaced
    #[arg(long, value_name = "DIR")]
    pub textures: Option<PathBuf>,

    /// Depth of the waves' parallax, 0 to 1; 0 is flat water, 0.2 the true height of the waves
    #[arg(long, value_name = "F", default_value_t = 0.2, allow_negative_numbers = true,
          value_parser = |text: &str| parse_within(text, 0.0, 1.0))]
    pub parallax_factor: f64,

    /// Offset of the water surface, metres, -2 to 2
    #[arg(long, value_name = "M", default_value_t = 0.0, allow_hyphen_values = true,
          value_parser = |text: &str| parse_within(text, -2.0, 2.0))]
    pub parallax_bias: f64,

    /// Steepness of the waves, 0 to 4; 1 is a fresh breeze
    #[arg(long, value_name = "S", default_value_t = 1.0, allow_negative_numbers = true,
          value_parser = |text: &str| parse_within(text, 0.0, 4.0))]
    pub wave_steepness: f64,

    /// Parallax occlusion mapping.
    #[command(flatten)]
    pub relief: PomArgs,

    /// Vegetation.
    #[command(flatten)]
    pub plants: VegetationArgs,

    /// From the HDR target to the image.
    #[command(flatten)]
    pub post: PostArgs,

    /// File whose first line is the server's access token
    #[arg(long, value_name = "FILE")]
    pub token_file: Option<PathBuf>,

    /// Certificate authorities in PEM that a `wss://` server is trusted by [default: the system's]
    #[arg(long, value_name = "FILE")]
    pub ca_file: Option<PathBuf>,

    /// Time limit of a shot for its complete view, seconds, 1 to 3600; it ends before if the first
    /// three connections fail [default: 60]
    #[arg(long, value_name = "S", allow_negative_numbers = true,
          value_parser = clap::value_parser!(u64).range(1..=3600))]
    pub timeout: Option<u64>,

    /// Size of the window's text and controls, 0.5 to 4 [default: 1]
    #[arg(long, value_name = "F", allow_negative_numbers = true,
          value_parser = |text: &str| parse_within(text, 0.5, 4.0))]
    pub ui_scale: Option<f64>,

    /// For tests of the window.
    #[command(flatten)]
    pub window_test: WindowTestArgs,
}

impl Args {
    /// The server, unless the scene generates its land or has none.
    #[must_use]
    pub fn server(&self) -> Option<Uri> {
        if self.scene.is_local() {
            return None;
        }
        let own_land = self.scene.has_own_land();
        self.connect.clone().or_else(|| (!own_land).then(|| Uri::from_static(DEFAULT_SERVER)))
    }

    /// Seed of the land that a scene generates.
    #[must_use]
    pub fn world_seed(&self) -> u64 {
        self.world_seed.unwrap_or(DEFAULT_WORLD_SEED)
    }

    /// A line for each given option of land, server, window or shot that has no effect beside the
    /// others.
    #[must_use]
    pub fn without_effect(&self) -> Vec<String> {
        let (is_local, has_server) = (self.scene.is_local(), self.server().is_some());
        let no_land = "this scene has no land";
        let no_server = "without a server, which --connect names";
        let of_server = [
            ("--digest", self.digest.is_some()),
            ("--token-file", self.token_file.is_some()),
            ("--ca-file", self.ca_file.is_some()),
            ("--delivery", self.delivery != Delivery::Exact),
        ];
        let seed_of_server = "the land is the server's: start it with this seed";
        let options = [
            ("--connect", is_local && self.connect.is_some(), no_land),
            ("--place", is_local && self.place.is_some(), no_land),
            ("--world-seed", is_local && self.world_seed.is_some(), no_land),
            ("--world-seed", has_server && self.world_seed.is_some(), seed_of_server),
            (
                "--timeout",
                self.shot.is_none() && self.timeout.is_some(),
                "a window waits as long as it is open",
            ),
            ("--ui-scale", self.shot.is_some() && self.ui_scale.is_some(), "a shot has no controls"),
        ];
        let of_server = of_server.map(|(option, is_given)| {
            (option, is_given && !has_server, if is_local { no_land } else { no_server })
        });
        let lines = options.into_iter().chain(of_server).filter(|(_, has_none, _)| *has_none);
        lines.map(|(option, _, why)| format!("{option} has no effect: {why}")).collect()
    }

    /// Size of the window's text and controls.
    #[must_use]
    pub fn ui_scale(&self) -> f64 {
        self.ui_scale.unwrap_or(1.0)
    }

    /// Vertical scale of the land.
    #[must_use]
    pub fn vertical_scale(&self) -> f64 {
        self.plants.vertical_scale.unwrap_or(self.scene.vertical_scale())
    }

    /// The render settings: those of the options, of the preset for the others.
    #[must_use]
    pub fn render_settings(&self, preset: &Preset) -> RenderSettings {
        RenderSettings {
            diffuse: self.diffuse,
            visibility: self.visibility,
            tiling: self.tiling.unwrap_or(preset.tiling),
            water: self.water.unwrap_or(preset.water),
            shadows: self.shadows,
            normals: self.normals,
            show: self.show,
            sun: self.sun,
            exposure_ev: self.exposure as f32,
            waves: WaveSettings {
                parallax_factor: self.parallax_factor as f32,
                parallax_bias_m: self.parallax_bias as f32,
                steepness: self.wave_steepness as f32,
            },
            plants: self.plants.vegetation_settings(preset.plants_in(self.scene)),
            pom: self.relief.pom_settings(preset.relief, self.scene),
            post: self.post.post_settings(self.scene, self.samples.unwrap_or(preset.samples), preset),
        }
    }

    /// Start pose.
    #[must_use]
    pub fn pose(&self) -> Pose {
        self.camera.unwrap_or_else(|| self.start_in(&Land::new(self.world_seed())))
    }

    /// Start pose in a world, without `--camera`.
    #[must_use]
    pub fn start_in(&self, land: &Land) -> Pose {
        match self.place {
            Some(place) if !self.scene.is_local() => places::find(place, land, self.vertical_scale()),
            _ => self.scene.start_in(land),
        }
    }

    /// Whether the camera moves to the start of the world that a server announces.
    #[must_use]
    pub fn follows_world(&self) -> bool {
        self.camera.is_none() && self.server().is_some()
    }

    /// Field of view and size.
    #[must_use]
    pub fn projection(&self) -> Projection {
        Projection { fov_deg: self.fov, width: self.size.0, height: self.size.1 }
    }
}

fn parse_url(text: &str) -> Result<Uri, String> {
    let expected = "expected ws://HOST:PORT/v1/stream, or wss:// with TLS";
    let url: Uri = text.parse().map_err(|error| format!("{error}, {expected}"))?;
    match url.scheme_str() {
        Some("ws" | "wss") if url.host().is_some_and(|host| !host.is_empty()) => Ok(url),
        _ => Err(expected.to_owned()),
    }
}

fn parse_digest(text: &str) -> Result<WorldDigest, String> {
    WorldDigest::from_hex(text)
        .ok_or_else(|| "expected the 64 hexadecimal digits that a server reports at /v1/world".to_owned())
}

fn parse_size(text: &str) -> Result<(u32, u32), String> {
    let side = |part: &str| part.parse().ok().filter(|side| (1..=MAX_SIDE).contains(side));
    text.split_once(['x', 'X'])
        .and_then(|(width, height)| Some((side(width)?, side(height)?)))
        .ok_or_else(|| format!("expected WxH such as 1280x720, each side 1 to {MAX_SIDE}"))
}

fn parse_sun(text: &str) -> Result<SunPosition, String> {
    let angle = |part: &str, limit: f64| parse_within(part.trim(), -limit, limit).ok();
    text.split_once(',')
        .and_then(|(azimuth, elevation)| Some((angle(azimuth, 360.0)?, angle(elevation, 90.0)?)))
        .map(|(azimuth, elevation)| SunPosition {
            azimuth_deg: azimuth.rem_euclid(360.0) as f32,
            elevation_deg: elevation as f32,
        })
        .ok_or_else(|| "expected AZIMUTH,ELEVATION, -360 to 360 and -90 to 90 degrees".to_owned())
}

fn parse_samples(text: &str) -> Result<u32, String> {
    match text {
        "1" => Ok(1),
        "4" => Ok(4),
        _ => Err("expected 1 or 4".to_owned()),
    }
}
