//! Hidden options of the window, for tests alone.

use std::path::PathBuf;

/// Actions of a test on the window.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct WindowTestArgs {
    /// For tests: loses the GPU device after each of these frames of the window.
    #[arg(long, value_name = "N,N", value_delimiter = ',', hide = true)]
    pub lose_gpu_at: Vec<u32>,
    /// For tests: the window ends after `--frames` frames once its view is complete, and writes the
    /// last one without its panel into this PNG file. The time of waves and clouds stands still.
    #[arg(long, value_name = "FILE.png", requires = "frames", hide = true)]
    pub last_frame: Option<PathBuf>,
}
