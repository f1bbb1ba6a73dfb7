//! The window after its GPU device was lost: a real window of the program, on an X server without a
//! screen. Without `Xvfb` the test is skipped; with `TOMBOLO_REQUIRE_DISPLAY` it fails instead.

#![cfg(target_os = "linux")]

use serde_json::Value;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

/// Least frames of a run; it ends once its view is complete.
const FRAMES: u32 = 150;

/// An X server on a display of its own, ended when dropped.
struct Display {
    server: Child,
    name: String,
}

impl Display {
    /// None without the program, unless it is required.
    fn open() -> Option<Self> {
        let mut command = Command::new("Xvfb");
        command.args(["-displayfd", "1", "-screen", "0", "320x240x24", "-nolisten", "tcp"]);
        let started = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn();
        let mut server = match started {
            Ok(server) => server,
            Err(error) => {
                assert!(std::env::var_os("TOMBOLO_REQUIRE_DISPLAY").is_none(), "Xvfb is required: {error}");
                eprintln!("SKIPPED: Xvfb cannot be started: {error}");
                return None;
            }
        };
        // It chooses a free display and prints its number.
        let mut number = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut number).unwrap();
        Some(Self { server, name: format!(":{}", number.trim()) })
    }

    /// Runs the viewer in a window of this display.
    fn view(&self, folder: &Path, name: &str, more: &[&str]) -> Output {
        let file = |extension: &str| folder.join(name).with_extension(extension);
        Command::new(env!("CARGO_BIN_EXE_tombolo-view"))
            // Land that is generated here, without plants, which the wind moves.
            .args(["--scene", "culling", "--grass", "0", "--trees", "0", "--view-distance", "400"])
            .args(["--size", "160x90", "--tolerance", "16", "--frames", &FRAMES.to_string()])
            .arg("--last-frame")
            .arg(file("png"))
            .arg("--stats")
            .arg(file("json"))
            .args(more)
            .env("DISPLAY", &self.name)
            .env_remove("WAYLAND_DISPLAY")
            .output()
            .unwrap()
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}

/// The picture of a run that ended well, and its count of rebuilds.
fn picture(display: &Display, folder: &Path, name: &str, more: &[&str]) -> (Vec<u8>, u64) {
    let output = display.view(folder, name, more);
    assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
    let file = |extension: &str| folder.join(name).with_extension(extension);
    let stats: Value = serde_json::from_slice(&std::fs::read(file("json")).unwrap()).unwrap();
    assert!(stats["seconds_to_complete_view"].is_number(), "{name}: the view is complete: {stats}");
    (image::open(file("png")).unwrap().into_rgba8().into_raw(), stats["gpu_rebuilds"].as_u64().unwrap())
}

/// Mean difference of two pictures' bytes, of 255.
fn difference(one: &[u8], other: &[u8]) -> f64 {
    assert_eq!(one.len(), other.len());
    one.iter().zip(other).map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / one.len() as f64
}

#[test]
fn the_window_shows_the_same_land_after_its_gpu_was_lost() {
    let Some(display) = Display::open() else { return };
    let folder = std::env::var_os("TOMBOLO_SCREENSHOTS").map_or_else(std::env::temp_dir, PathBuf::from);
    let folder = folder.join(format!("tombolo-window-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let (whole, rebuilds) = picture(&display, &folder, "whole", &[]);
    assert_eq!(rebuilds, 0);
    let (again, rebuilds) = picture(&display, &folder, "again", &["--lose-gpu-at", "40,140"]);
    assert_eq!(rebuilds, 2);
    assert!(whole == again, "the picture differs by {} of 255", difference(&whole, &again));
    // The control: another view differs.
    let (other, _) = picture(&display, &folder, "other", &["--sun", "90,5"]);
    assert!(difference(&whole, &other) > 5.0, "{}", difference(&whole, &other));
    // A device that is lost again and again ends the program with its cause.
    let ended = display.view(&folder, "ended", &["--lose-gpu-at", "10,11,12,13"]);
    let message = String::from_utf8_lossy(&ended.stderr);
    assert!(!ended.status.success() && message.contains("lost"), "{message}");
    if std::env::var_os("TOMBOLO_SCREENSHOTS").is_none() {
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
