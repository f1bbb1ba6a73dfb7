//! egui over the image of a window.

use crate::gpu::Gpu;
use winit::window::Window;

/// egui over the image of a window.
pub struct Overlay {
    context: egui::Context,
    input: egui_winit::State,
    painter: egui_wgpu::Renderer,
}

/// A panel ready to be painted.
pub struct Painted {
    jobs: Vec<egui::ClippedPrimitive>,
    textures: egui::TexturesDelta,
    screen: egui_wgpu::ScreenDescriptor,
}

impl Overlay {
    /// egui for a window with this image format; `scale` multiplies the size of text and controls.
    #[must_use]
    pub fn new(gpu: &Gpu, window: &Window, format: wgpu::TextureFormat, scale: f64) -> Self {
        let context = egui::Context::default();
        context.set_zoom_factor(scale as f32);
        let side = gpu.device.limits().max_texture_dimension_2d as usize;
        let input = egui_winit::State::new(
            context.clone(),
            egui::ViewportId::ROOT,
            window,
            Some(window.scale_factor() as f32),
            None,
            Some(side),
        );
        let painter = egui_wgpu::Renderer::new(&gpu.device, format, egui_wgpu::RendererOptions::default());
        Self { context, input, painter }
    }

    /// The overlay on a new device: open groups, positions and the size of text stay.
    #[must_use]
    pub fn reopened(&self, gpu: &Gpu, window: &Window, format: wgpu::TextureFormat) -> Self {
        let new = Self::new(gpu, window, format, self.context.zoom_factor().into());
        let memory = self.context.memory(Clone::clone);
        new.context.memory_mut(|new| *new = memory);
        new
    }

    /// Whether a text field has the focus.
    #[must_use]
    pub fn is_typing(&self) -> bool {
        self.context.egui_wants_keyboard_input()
    }

    /// Passes an event to the panel; true if the panel consumed it.
    pub fn takes(&mut self, window: &Window, event: &winit::event::WindowEvent) -> bool {
        self.input.on_window_event(window, event).consumed
    }

    /// Whether events wait for [`Overlay::run`].
    #[must_use]
    pub fn has_events(&self) -> bool {
        !self.input.egui_input().events.is_empty()
    }

    /// Lays out what `show` describes.
    pub fn run(
        &mut self,
        window: &Window,
        size: (u32, u32),
        mut show: impl FnMut(&egui::Context),
    ) -> Painted {
        let input = self.input.take_egui_input(window);
        let output = self.context.run_ui(input, |ui| show(ui.ctx()));
        self.input.handle_platform_output(window, output.platform_output);
        let screen = egui_wgpu::ScreenDescriptor {
            size_in_pixels: [size.0, size.1],
            pixels_per_point: output.pixels_per_point,
        };
        let jobs = self.context.tessellate(output.shapes, output.pixels_per_point);
        Painted { jobs, textures: output.textures_delta, screen }
    }

    /// Paints the panel over the image in `view`.
    pub fn paint(
        &mut self,
        gpu: &Gpu,
        painted: Painted,
        encoder: &mut wgpu::CommandEncoder,
        view: &wgpu::TextureView,
    ) {
        let Painted { jobs, mut textures, screen } = painted;
        for (id, deltas) in textures.set.drain() {
            for delta in &deltas {
                self.painter.update_texture(&gpu.device, &gpu.queue, id, delta);
            }
        }
        self.painter.update_buffers(&gpu.device, &gpu.queue, encoder, &jobs, &screen);
        let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("panel"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store },
            })],
            ..Default::default()
        });
        // egui requires a pass that does not borrow the encoder; nothing else is recorded until it
        // ends here.
        self.painter.render(&mut pass.forget_lifetime(), &jobs, &screen);
        for id in textures.free.drain() {
            self.painter.free_texture(&id);
        }
    }
}
