"""Light and shadow in one pass: a shader in the place of MuJoCo's two.

MuJoCo draws the scene by all lights without shadows, and once more, added up, by each light that casts them. Filled by
a processor each pass costs the same, so the second one doubles the price of a picture. MuJoCo uses no shader of its
own, and one that is bound while it draws takes the place of OpenGL's fixed formula, which is evaluated here for both
passes at once, with the shadow map that MuJoCo drew. That one is drawn anew only when something has moved: through a
sweep of the empty hall, never.
"""

from __future__ import annotations

import importlib
from typing import Any, Final

import mujoco
import numpy as np

from pzcap.types import Array

_TEXTURED: Final = 1.0  # shininess of materials with a texture; geoms without a material have 0.5

_WORLD_R_ORIGIN_EYE: Final = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Orientation of the eye at the world's origin that the shadow map is drawn for, by OpenGL's axes: forward is x."""

_VERTEX: Final = """#version 120
uniform mat4 shadow_T_eye;
varying float alpha;
varying vec3 always, unless_shadowed, at;
varying vec2 uv;
void main() {
    vec4 eye = gl_ModelViewMatrix * gl_Vertex;
    vec3 normal = normalize(gl_NormalMatrix * gl_Normal);
    always = gl_FrontMaterial.emission.rgb;
    for (int i = 0; i < LIGHTS; i++) {
        float facing = max(dot(normal, normalize(gl_LightSource[i].position.xyz)), 0.0);
        vec3 level = gl_Color.rgb * (gl_LightSource[i].ambient.rgb + gl_LightSource[i].diffuse.rgb * facing);
        if (i == CASTS) unless_shadowed = clamp(level, 0.0, 1.0); else always += level;
    }
    always = clamp(always, 0.0, 1.0);
    alpha = gl_Color.a;
    uv = gl_MultiTexCoord0.st;
    at = (shadow_T_eye * eye).xyz;
    gl_Position = ftransform();
}
"""
_FRAGMENT: Final = """#version 120
uniform sampler2D texture;
uniform sampler2DShadow shadow;
varying float alpha;
varying vec3 always, unless_shadowed, at;
varying vec2 uv;
void main() {
    vec3 colour = gl_FrontMaterial.shininess > 100.0 ? texture2D(texture, uv).rgb : vec3(1.0);
    vec3 level = always;
    if (unless_shadowed.g > 0.0) level += step(0.99, shadow2D(shadow, at).r) * unless_shadowed;
    gl_FragColor = vec4(colour * level, alpha);
}
"""


def casts_one_shadow(model: mujoco.MjModel) -> bool:
    """Can the scene be drawn in one pass? It can if its lights are directional, none shines, and one casts shadows."""
    directional = model.light_type == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    shines = model.light_specular.any() or model.vis.headlight.specular.any()
    return bool(directional.all() and not shines and np.count_nonzero(model.light_castshadow) == 1)


class ShadowedPass:
    """Draws a scene that `casts_one_shadow` in the context that is current.

    To tell materials with a texture from those without, their shininess is overwritten, which no light shows.
    """

    def __init__(self, model: mujoco.MjModel, gpu: mujoco.MjrContext) -> None:
        self._gl: Any = importlib.import_module("OpenGL.GL")  # for the backend that MuJoCo has chosen
        self._gpu = gpu
        textured = model.mat_texid[:, mujoco.mjtTextureRole.mjTEXROLE_RGB] >= 0
        model.mat_shininess[:] = np.where(textured, _TEXTURED, 0.0)
        headlight = int(model.vis.headlight.active > 0)  # stands before the others in a scene
        words = {
            "LIGHTS": str(headlight + model.nlight),
            "CASTS": str(headlight + int(np.flatnonzero(model.light_castshadow)[0])),
        }
        self._program = self._build(words)
        self._matrix = self._gl.glGetUniformLocation(self._program, "shadow_T_eye")
        self._shadow_T_world = np.eye(4)
        self._arranged: tuple[Array, ...] | None = None

    def draw(
        self, rectangle: mujoco.MjrRect, scene: mujoco.MjvScene, world_T_eye: Array, arranged: tuple[Array, ...]
    ) -> None:
        """Draw ``scene``, as `mujoco.mjr_render` does.

        world_T_eye: (4, 4) pose of the camera by OpenGL's axes, x right, y up, z backwards.
        arranged: all that the shadows depend on. The shadow map is kept while it stays the same.
        """
        gl = self._gl
        if self._arranged is None or not all(map(np.array_equal, arranged, self._arranged)):
            self._draw_shadow_map(scene)
            self._arranged = tuple(np.array(part) for part in arranged)
        gl.glActiveTexture(gl.GL_TEXTURE1)
        gl.glBindTexture(gl.GL_TEXTURE_2D, self._gpu.shadowTex)
        gl.glActiveTexture(gl.GL_TEXTURE0)
        gl.glUseProgram(self._program)
        gl.glUniformMatrix4fv(self._matrix, 1, gl.GL_TRUE, (self._shadow_T_world @ world_T_eye).astype(np.float32))
        scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        mujoco.mjr_render(rectangle, scene, self._gpu)
        scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 1
        gl.glUseProgram(0)

    def _draw_shadow_map(self, scene: mujoco.MjvScene) -> None:
        """Have MuJoCo draw the shadow map, and take over where in it a point of the world is, for an eye at the origin:
        by the camera's own it would be rounded otherwise for every order of the cameras."""
        gl, placed = self._gl, [(eye.pos.copy(), eye.forward.copy(), eye.up.copy()) for eye in scene.camera]
        for eye in scene.camera:
            eye.pos[:], eye.forward[:], eye.up[:] = 0.0, -_WORLD_R_ORIGIN_EYE[:, 2], _WORLD_R_ORIGIN_EYE[:, 1]
        mujoco.mjr_render(mujoco.MjrRect(0, 0, 1, 1), scene, self._gpu)
        for eye, place in zip(scene.camera, placed, strict=True):
            eye.pos[:], eye.forward[:], eye.up[:] = place
        gl.glActiveTexture(gl.GL_TEXTURE1)
        planes = [gl.glGetTexGenfv(axis, gl.GL_EYE_PLANE) for axis in (gl.GL_S, gl.GL_T, gl.GL_R, gl.GL_Q)]
        self._shadow_T_world[:, :3] = np.array(planes, np.float64)[:, :3] @ _WORLD_R_ORIGIN_EYE.T
        self._shadow_T_world[:, 3] = np.array(planes, np.float64)[:, 3]

    def _build(self, words: dict[str, str]) -> int:
        """Compile the two shaders, with ``words`` replaced, to a program."""
        gl = self._gl
        program = gl.glCreateProgram()
        for kind, source in ((gl.GL_VERTEX_SHADER, _VERTEX), (gl.GL_FRAGMENT_SHADER, _FRAGMENT)):
            for word, value in words.items():
                source = source.replace(word, value)
            shader = gl.glCreateShader(kind)
            gl.glShaderSource(shader, source)
            gl.glCompileShader(shader)
            gl.glAttachShader(program, shader)
        gl.glLinkProgram(program)
        if not gl.glGetProgramiv(program, gl.GL_LINK_STATUS):
            raise RuntimeError(f"the shader does not compile: {gl.glGetProgramInfoLog(program)}")
        gl.glUseProgram(program)
        for unit, sampler in enumerate(("texture", "shadow")):
            gl.glUniform1i(gl.glGetUniformLocation(program, sampler), unit)
        gl.glUseProgram(0)
        return int(program)
