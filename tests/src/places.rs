//! Cameras of the home island of world 1, as `--camera` takes them: [`lab::places`].

use client::camera::Pose;
use client::scene::Scene;
use lab::places;
use std::sync::LazyLock;
use terrain::Land;

/// The start view of the island scene.
pub static START: LazyLock<String> = LazyLock::new(|| Scene::Island.start().to_string());

/// Mountains, from above them.
pub static MOUNTAINS: LazyLock<String> = LazyLock::new(|| camera(places::over_mountains));

/// A coast, along it.
pub static SHORE: LazyLock<String> = LazyLock::new(|| camera(places::along_shore));

/// A beach and the water before it.
pub static BEACH: LazyLock<String> = LazyLock::new(|| camera(places::beach));

/// Deep water near that beach, looking out to sea.
pub static SEA: LazyLock<String> = LazyLock::new(|| camera(places::off_shore));

/// The middle of the island from high above.
pub static ABOVE: LazyLock<String> = LazyLock::new(|| places::above().to_string());

/// A meadow with trees, at eye height.
pub static MEADOW: LazyLock<String> = LazyLock::new(|| Scene::Grass.start().to_string());

/// The floor of a narrow valley; the eye is below its ground or just above it.
pub static VALLEY: LazyLock<String> = LazyLock::new(|| Scene::Culling.start().to_string());

fn camera(place: impl Fn(&Land) -> Pose) -> String {
    place(&Land::new(1)).to_string()
}

/// A camera at another height above the sea, with other angles; metres and degrees.
///
/// # Panics
/// The camera cannot be parsed.
#[must_use]
pub fn moved(camera: &str, up_m: f64, yaw_deg: f64, pitch_deg: f64) -> String {
    let pose: Pose = camera.parse().unwrap_or_else(|_| panic!("camera `{camera}`"));
    let position_m = pose.position_m.with_y(up_m);
    format!("{:.3}", Pose { position_m, yaw_deg, pitch_deg })
}
