//! Everything that needs an operating system: options, sockets and threads, files, the window.

pub mod app;
pub mod args;
pub mod parse;
pub mod png_file;
pub mod pom_args;
pub mod screenshot;
pub mod stream;
pub mod textures;
pub mod vegetation_args;

use args::Args;

/// Runs the program that the options describe. Errors are one line, for display.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let started = std::time::Instant::now();
    if args.shot.is_some() { screenshot::run(args, started) } else { app::run(args, started) }
}
