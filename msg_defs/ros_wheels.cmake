# Where ROS comes from wheels instead of /opt/ros; pyproject.toml names this file. Needed because the wheels do not say
# where they are, and their CMake targets name the Python headers of the machine that built them.

find_package(Python3 REQUIRED COMPONENTS Interpreter)

execute_process(
  COMMAND "${Python3_EXECUTABLE}" -c
          "import ament_package, pathlib; print(pathlib.Path(ament_package.__file__).parents[4].as_posix())"
  OUTPUT_VARIABLE ros_prefix OUTPUT_STRIP_TRAILING_WHITESPACE COMMAND_ERROR_IS_FATAL ANY)
execute_process(
  COMMAND "${Python3_EXECUTABLE}" -c "import sysconfig; print(sysconfig.get_path('include'))"
  OUTPUT_VARIABLE python_headers OUTPUT_STRIP_TRAILING_WHITESPACE COMMAND_ERROR_IS_FATAL ANY)

list(PREPEND CMAKE_PREFIX_PATH "${ros_prefix}")
set(ENV{AMENT_PREFIX_PATH} "${ros_prefix}")

# Nobody compiles C++ against these messages here: rclpy and Fast DDS load the type supports in C. The others would take
# half of the time.
set(needless_generators
  rosidl_generator_cpp rosidl_typesupport_cpp rosidl_typesupport_fastrtps_cpp rosidl_typesupport_introspection_cpp)

# To be called when all packages have been found, for each of them registers itself then.
macro(leave_out_needless_generators)
  foreach(generator IN LISTS needless_generators)
    list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "^${generator}:")
  endforeach()
endmacro()

# At the end of the project, when all targets have been imported.
function(use_local_python_headers)
  get_directory_property(targets IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(directories ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(directories)
      list(TRANSFORM directories REPLACE "^/opt/python/.*" "${python_headers}")
      set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${directories}")
    endif()
  endforeach()
endfunction()

cmake_language(DEFER CALL use_local_python_headers)
