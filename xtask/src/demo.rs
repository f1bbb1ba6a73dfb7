//! `demo`: a server and a viewer on it, with one command.

use crate::process;
use crate::server::Server;
use crate::setup::{self, Extent};
use anyhow::{Context, Result, bail};
use terrain::constants::UNITS_PER_METRE;
use terrain::{Land, Position};

/// The world that the demo shows.
const WORLD_SEED: u64 = 1;

/// The programs of the demo.
pub const PROGRAMS: [&str; 2] = ["tombolo-server", "tombolo-view"];

/// Options of `demo`.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct Options {
    /// Render a short flight to PNGs instead of opening a window; so does a missing display
    #[arg(long)]
    pub headless: bool,
}

/// One picture of the flight.
#[derive(Clone, Copy, Debug)]
struct Shot {
    name: &'static str,
    /// Place in metres east and south of the island's middle.
    place_m: (f64, f64),
    /// Above the ground or the sea, metres.
    clearance_m: f64,
    /// Heading (0 is north, 90 east) and elevation of the gaze, degrees.
    gaze: (f64, f64),
}

/// From the open sea over beach and hills to the middle of the island and back to the coast.
const FLIGHT: [Shot; 6] = [
    Shot { name: "1-arrival", place_m: (-3000.0, 2400.0), clearance_m: 160.0, gaze: (50.0, -4.0) },
    Shot { name: "2-coast", place_m: (-1500.0, 1200.0), clearance_m: 60.0, gaze: (50.0, -6.0) },
    Shot { name: "3-hills", place_m: (-300.0, 400.0), clearance_m: 180.0, gaze: (80.0, -12.0) },
    Shot { name: "4-ridge", place_m: (1500.0, 700.0), clearance_m: 200.0, gaze: (20.0, -14.0) },
    Shot { name: "5-overview", place_m: (-3000.0, 3000.0), clearance_m: 900.0, gaze: (45.0, -18.0) },
    Shot { name: "6-shore", place_m: (0.0, -3000.0), clearance_m: 12.0, gaze: (-160.0, 2.0) },
];

/// Sets up, builds, starts the server, shows the island, stops the server.
///
/// # Errors
/// Whatever of this does not work; the server is stopped in every case.
pub fn run(options: Options) -> Result<()> {
    let headless = options.headless || !has_display();
    setup::run(if headless { Extent::Headless } else { Extent::Everything })?;
    let (build, minutes) = if headless {
        (process::build_without_window(&PROGRAMS), "about 5")
    } else {
        (process::build(&PROGRAMS), "about 8")
    };
    println!(
        "demo: building the server and the viewer: {minutes} minutes on 2 cores the first time, seconds later"
    );
    process::run(build).context("demo: the build failed")?;
    let server = Server::start(WORLD_SEED).context("demo")?;
    println!("demo: a server streams world {WORLD_SEED} at {}", server.stream());
    if headless { fly(&server, options) } else { show(&server) }
}

fn show(server: &Server) -> Result<()> {
    println!("demo: opening the viewer; close its window to end");
    let mut viewer = process::viewer();
    viewer.args(["--connect", &server.stream()]);
    process::run(viewer).context("demo: the viewer failed; `cargo demo -- --headless` needs no window")
}

fn fly(server: &Server, options: Options) -> Result<()> {
    let why = if options.headless { "as asked" } else { "no display is set" };
    println!("demo: rendering {} pictures without a window ({why})", FLIGHT.len());
    let folder = process::target().join("demo");
    std::fs::create_dir_all(&folder).with_context(|| format!("demo: cannot create {}", folder.display()))?;
    let land = Land::new(WORLD_SEED);
    for (number, shot) in (1..).zip(FLIGHT) {
        let picture = folder.join(shot.name).with_extension("png");
        // A picture of an earlier run must not pass for one of this.
        let _ = std::fs::remove_file(&picture);
        let mut viewer = process::viewer();
        viewer
            .args(["--connect", &server.stream(), "--scene", "island", "--size", "1280x720"])
            .arg(format!("--camera={}", shot.camera(&land)))
            .arg("--shot")
            .arg(&picture);
        process::run(viewer).with_context(|| format!("demo: picture {} failed", shot.name))?;
        if !picture.is_file() {
            bail!("demo: the viewer ended well and left no {}", picture.display());
        }
        println!("demo: picture {number} of {}: {}", FLIGHT.len(), picture.display());
    }
    Ok(())
}

impl Shot {
    /// `X,Y,Z,YAW,PITCH` as the viewer takes it: metres and degrees, above whatever ground is
    /// there.
    fn camera(&self, land: &Land) -> String {
        let (east, south) = self.place_m;
        let units = |metres: f64| (metres * f64::from(UNITS_PER_METRE)) as i32;
        let ground = Position::new(units(east), units(south)).map_or(0, |place| land.height_at(place));
        let up = f64::from(ground.max(0)) / f64::from(UNITS_PER_METRE) + self.clearance_m;
        let (yaw, pitch) = self.gaze;
        format!("{east:.1},{up:.1},{south:.1},{yaw:.1},{pitch:.1}")
    }
}

fn has_display() -> bool {
    // Elsewhere a window system is always there.
    !cfg!(target_os = "linux")
        || ["DISPLAY", "WAYLAND_DISPLAY"]
            .map(std::env::var_os)
            .into_iter()
            .flatten()
            .any(|name| !name.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_camera_of_the_flight_is_above_ground_and_sea() {
        let land = Land::new(WORLD_SEED);
        for shot in FLIGHT {
            let camera = shot.camera(&land);
            let numbers: Vec<f64> = camera.split(',').map(|number| number.parse().unwrap()).collect();
            assert_eq!(numbers.len(), 5, "{camera}");
            let place = Position::new((numbers[0] * 256.0) as i32, (numbers[2] * 256.0) as i32).unwrap();
            let ground_m = f64::from(land.height_at(place).max(0)) / 256.0;
            assert!(numbers[1] >= ground_m + shot.clearance_m - 0.1, "{camera} over {ground_m}");
        }
    }
}
