"""Draws with pyrender in a process of its own, so that a broken OpenGL driver cannot end the program.

Run as a script by :mod:`render.gl`. Messages are pickles on standard input and output, between a program and
the child it started; ``PYOPENGL_PLATFORM`` is set by the parent, before anything here is imported.
"""

import os
import pickle
import sys

import numpy as np

FAR_MARGIN = 1.01
LINEAR, CLAMP, REPEAT = 9729, 33071, 10497  # OpenGL's names for filtering and wrapping
LAST_LINE = "frag_color = clamp(base_color, 0.0, 1.0);"
CUT_OUT = "if (base_color.a < 0.5) discard;\n    " + LAST_LINE


def main():
    replies = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a driver prints must not get between the messages
    import pyrender
    import pyrender.renderer as backend
    from OpenGL import GL

    plain = backend.glRenderbufferStorageMultisample
    # Four samples a pixel make software drivers several times slower; the images are drawn larger instead.
    backend.glRenderbufferStorageMultisample = lambda target, samples, *rest: plain(target, 0, *rest)
    _cut_out_alpha()
    offscreen = pyrender.OffscreenRenderer(16, 16)
    offscreen._platform.make_current()
    device = GL.glGetString(GL.GL_RENDERER).decode(errors="replace")
    _send(replies, device)
    while True:
        try:
            request = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        _send(replies, _draw(pyrender, offscreen, **request))


def _cut_out_alpha():
    """Have the flat shader discard what is transparent; as it is, it would write its depth: a halo."""
    from pyrender.shader_program import ShaderProgram

    plain = ShaderProgram._load

    def load(program, filename):
        text = plain(program, filename)
        if os.path.basename(filename) == "flat.frag":
            if text.count(LAST_LINE) != 1:
                raise RuntimeError("pyrender's flat shader is not the one that can be mended")
            text = text.replace(LAST_LINE, CUT_OUT)
        return text

    ShaderProgram._load = load


def _send(stream, message):
    pickle.dump(message, stream, protocol=5)
    stream.flush()


def _draw(pyrender, offscreen, pose, yfov, width, height, layers):
    """Depth, and one flat image for each set of vertex colours, of every layer."""
    offscreen.viewport_width, offscreen.viewport_height = width, height
    return [_draw_layer(pyrender, offscreen, pose, yfov, width / height, **layer) for layer in layers]


def _surface(pyrender, texture):
    """Material, and texture coordinates if there are any."""
    white = {"baseColorFactor": (1.0, 1.0, 1.0, 1.0)}
    if texture is None:
        return pyrender.MetallicRoughnessMaterial(**white), {}
    uv, image, clamp, both_sides = texture
    wrap = CLAMP if clamp else REPEAT
    sampler = pyrender.Sampler(magFilter=LINEAR, minFilter=LINEAR, wrapS=wrap, wrapT=wrap)  # no mipmaps
    picture = pyrender.Texture(source=image, source_channels="RGBA", sampler=sampler)
    material = pyrender.MetallicRoughnessMaterial(
        **white, baseColorTexture=picture, doubleSided=both_sides, alphaMode="OPAQUE"
    )
    return material, {"texcoord_0": uv}


def _draw_layer(pyrender, offscreen, pose, yfov, aspect, vertices, faces, colors, texture=None):
    depth_of = (pose[:3, 3] - vertices) @ pose[:3, 2]
    near = max(float(depth_of.min()) / FAR_MARGIN, 1e-4 * float(depth_of.max()))
    camera = pyrender.PerspectiveCamera(
        yfov=yfov, aspectRatio=aspect, znear=near, zfar=float(depth_of.max()) * FAR_MARGIN
    )
    images, depth = [], None
    for color in colors:
        scene = pyrender.Scene(bg_color=(0.0, 0.0, 0.0, 0.0))
        material, more = _surface(pyrender, texture)
        primitive = pyrender.Primitive(
            positions=vertices.astype(np.float32), indices=faces, color_0=color, material=material, **more
        )
        scene.add(pyrender.Mesh([primitive]))
        scene.add(camera, pose=pose)
        image, depth = offscreen.render(scene, flags=pyrender.RenderFlags.FLAT)
        images.append(np.ascontiguousarray(image[:, :, :3]))
    return np.ascontiguousarray(depth), images


if __name__ == "__main__":
    main()
