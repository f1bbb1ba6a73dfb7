//! Frames on a new device once the present one is lost.

use super::{FrameOutcome, LONG_NOTICE_DURATION, WindowState};
use crate::features::vegetation::gpu_cull::CullStats;
use crate::gpu::GpuError;
use crate::renderer::{RenderOptions, Renderer};
use std::sync::Arc;
use std::time::Instant;

impl WindowState {
    /// Draws a frame; on a new device if the present one is lost.
    ///
    /// # Errors
    /// The GPU failed otherwise, or too often.
    pub fn redraw(&mut self) -> anyhow::Result<FrameOutcome> {
        match self.draw_frame() {
            Err(error) => {
                let error = error.downcast::<GpuError>()?;
                let cause = self.rebuilds.begin(&self.gpu, error)?;
                self.rebuild()?;
                let line = format!("the GPU failed and was opened again: {cause}");
                self.notices.show(&line, Instant::now(), LONG_NOTICE_DURATION);
                Ok(FrameOutcome::Continue)
            }
            drawn => drawn,
        }
    }

    /// Opens a new device with its surface and renderer, and uploads the chunk cache.
    fn rebuild(&mut self) -> anyhow::Result<()> {
        let surface = self.gpu.instance.create_surface(Arc::clone(&self.window))?;
        self.gpu = pollster::block_on(self.gpu.reopen(Some(&surface)))?;
        let size = self.window.inner_size();
        self.surface.replace(&self.gpu, surface, (size.width, size.height))?;
        let options =
            RenderOptions { size: self.surface.size(), format: self.surface.format, ..self.render_options };
        self.renderer = Renderer::with_materials(&self.gpu, &options, &self.materials);
        self.overlay = self.overlay.reopened(&self.gpu, &self.window, self.surface.format);
        let (gpu, renderer) = (&self.gpu, &mut self.renderer);
        self.streamer.cache().residents().for_each(|chunk| renderer.upload(gpu, chunk));
        self.adapter = self.gpu.name();
        // Counts of the lost device do not come.
        (self.cull_stats, self.cull_stats_pending) = (CullStats::default(), None);
        Ok(())
    }
}
