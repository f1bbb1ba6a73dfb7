//! Everything that needs an operating system: options, sockets and threads, files, the window.

#[cfg(feature = "window")]
pub mod app;
pub mod args;
pub mod background;
pub mod parse;
pub mod png_file;
pub mod pom_args;
pub mod post_args;
pub mod profile;
pub mod quality;
pub mod screenshot;
pub mod stream;
pub mod textures;
pub mod vegetation_args;
pub mod window_test_args;

use args::Args;

/// Runs the program that the options describe. Errors are one line, for display.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let started = std::time::Instant::now();
    for line in args.without_effect() {
        eprintln!("{line}");
    }
    if args.shot.is_some() { screenshot::run(args, started) } else { window(args, started) }
}

#[cfg(feature = "window")]
fn window(args: &Args, started: std::time::Instant) -> anyhow::Result<()> {
    app::run(args, started)
}

#[cfg(not(feature = "window"))]
fn window(_: &Args, _: std::time::Instant) -> anyhow::Result<()> {
    anyhow::bail!(
        "this viewer was built without its window: draw into a file with --shot FILE.png, or build it again \
        with `cargo build --release --bin tombolo-view`"
    )
}
