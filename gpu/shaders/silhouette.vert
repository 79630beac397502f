// All particles of a batch in one draw call per part: each instance is a particle, drawn into its own tile of the atlas.
#version 330

in vec3 position;      // body frame
in vec4 to_x, to_y;    // this particle's and part's affine camera (joints applied): body point -> pixel
in vec2 origin;        // the tile's corner, in pixels of the image

uniform ivec2 tile;    // size, pixels
uniform int across;    // tiles in a row of the atlas
uniform vec2 atlas;    // size, pixels

out float gl_ClipDistance[4];   // a silhouette stays within its tile

void main()
{
    vec2 pixel = vec2(dot(to_x, vec4(position, 1.0)), dot(to_y, vec4(position, 1.0))) - origin;
    gl_ClipDistance[0] = pixel.x;
    gl_ClipDistance[1] = float(tile.x) - pixel.x;
    gl_ClipDistance[2] = pixel.y;
    gl_ClipDistance[3] = float(tile.y) - pixel.y;
    vec2 place = pixel + vec2(ivec2(gl_InstanceID % across, gl_InstanceID / across) * tile);
    gl_Position = vec4(place / atlas * 2.0 - 1.0, 0.0, 1.0);
}
