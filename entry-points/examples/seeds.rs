//! Writes the valid inputs of every entry point as files, one folder each: where a search by
//! coverage starts.
//!
//!     cargo run -p tombolo-entry-points --example seeds -- FOLDER

use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args_os().nth(1).map(PathBuf::from).ok_or("give a folder")?;
    for point in entry_points::ALL {
        let folder = folder.join(point.name);
        std::fs::create_dir_all(&folder)?;
        for (number, seed) in (point.seeds)().iter().enumerate() {
            std::fs::write(folder.join(format!("seed-{number}")), seed)?;
        }
    }
    Ok(())
}
